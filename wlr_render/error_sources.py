"""Sources of a model's errors in an error budget, each with its remedy."""

from enum import StrEnum


class ErrorSource(StrEnum):
    """Source of a model's errors: its name in reports and files, and a sentence that states the remedy."""

    remedy: str

    def __new__(cls, name: str, remedy: str) -> "ErrorSource":
        """Return the source of this name."""
        source = str.__new__(cls, name)
        source._value_, source.remedy = name, remedy
        return source

    NOISE_AND_STAGE = "noise and stage", "Add camera positions, or repeat the photographs."
    """Errors that display and see-through do not share."""
    TRUNCATION = "truncation", "Add camera positions, or fit models of higher degree."
    PRESCRIPTION = "prescription", "Add camera positions, which determine the assembly errors."
    ALIGNMENTS = "alignments", "Align more points, at several distances and over the whole panel."

    LENS = "lens", "Take more photographs of the board with the eyeball camera, over its whole picture."
    BOARD = "board", "Measure the board's scale and its bow, or take a stiffer board."
    TRACKING_CAMERA = (
        "tracking camera",
        "Measure the camera's lens and its pose in the headset more accurately, or track head and eyes with that "
        "camera, where an error of its pose cancels: budget --camera-frame.",
    )
    TARGETS = "targets", "Take more photographs of the targets without the headset."
    """Poses of the targets; only fits of the poses to the dots have this source."""
    STAGE = "stage", "Take more photographs without the headset, over the whole travel of the stage."
    """Axes of the stage, and the camera's pose on it."""
    BENCH_DRIFT = "drift of the bench", "Let camera and stage warm up before the calibration."

    BOARD_SHAPE = "shape of the board", "Flatten the board, or measure its shape."
    SHAPE_AT_POSES = (
        "shape of the board at each pose",
        "Hold the board flat at all poses, and let the camera's focus alone.",
    )
    PRINTING = (
        "printing errors of the board",
        "Print the board on glass, measure its dots, or turn it by 90 degrees at one pose.",
    )
    VISITS = "errors of each visit", "Let the stage settle before each photograph."
    DRIFT = "drift", "Let camera and headset warm up, and visit the positions in random order."
    STAGE_AXES = "stage axes", "Measure the errors of the stage along its axes, or track the camera."
    TRAVEL = "direction of travel", "Approach all positions from one side."
    FIELD = (
        "errors by place in the field",
        "Check the camera's lens and the decoding; else the optics are less smooth than the model.",
    )


def remedy(source: str) -> str:
    """Return the sentence that states the remedy for errors of a source, which captures of a user may name freely."""
    unknown = f"Reduce the errors that the captures name '{source}'."
    return next((each.remedy for each in ErrorSource if each == source), unknown)
