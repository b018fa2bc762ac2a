"""session.toml of a photographic session: reading and writing (docs/photo-session.md has the format)."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern, pattern_keys
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session import BoardPhotograph, CodeSet, PhotoSession, SessionCamera
from wlr_render.captures.photographs import photographs_in
from wlr_render.errors import BadInputError
from wlr_render.files import resource
from wlr_render.geometry.lens_camera import DISTORTION_TERMS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.geometry.transforms import FRAMES, is_rotation, rigid
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.toml_files import Table, read_toml, write_toml

FILE = "session.toml"
FORMAT = "photo-session"
VERSION = 1
_MM = 1e-3

# What lengths of a bench can be, in millimetres: beyond, somebody has written metres or micrometres.
_EYE_BOX_MM = (0.5, 100.0)
_CAMERA_PLACE_MM = (0.5, 1000.0)
_TRAVEL_MM = (0.5, 500.0)


def load_photo_session(folder: str | Path) -> PhotoSession:
    """Read the session.toml of a folder; the photographs themselves are not opened.

    Raises:
        BadInputError: the file is missing or breaks the format, or its lengths cannot be millimetres; the sentence says
            which key.
    """
    root = Path(folder)
    if not (root / FILE).is_file():
        if (root / "bench.toml").is_file():
            raise BadInputError(
                f"{root}: is a bench session, not a photographic session; run `wlr-render calibrate captures {root}`."
            )
        manual = resource("docs", "photo-session.md")
        raise BadInputError(f"{root}: has no {FILE}, so it is not a photographic session; {manual} has the format.")
    file = read_toml(root / FILE)
    file.check_head(FORMAT, VERSION, "a session")
    axes = FRAMES[file.text("frame", choices=sorted(FRAMES))]
    device, eye = file.text("device"), file.text("eye", choices=("left", "right"))
    pattern, decoding_keys = _pattern(file)
    eyeball_table = file.table("eyeball_camera")
    eyeball = _camera(eyeball_table, root)
    eyeball_table.finish()
    tracking, device_from_tracking = _tracking_camera(file, root, axes)
    session = PhotoSession(
        folder=root,
        device=device,
        eye=eye,
        eye_box=_eye_box(file, axes),
        pattern=pattern,
        decoding=DecodeOptions(full_scale=eyeball.full_scale, **decoding_keys),
        board=load_board(root / file.text("board")),
        eyeball_camera=eyeball,
        tracking_camera=tracking,
        device_from_tracking=device_from_tracking,
        bare=tuple(_board_photograph(table, root, axes) for table in file.tables("bare")),
        tracking=tuple(_board_photograph(table, root, axes, on_stage=False) for table in file.tables("tracking")),
        see_through=tuple(_board_photograph(table, root, axes) for table in file.tables("see_through")),
        display=tuple(_code_set(table, root, axes) for table in file.tables("display")),
    )
    file.finish()
    _check_lists(file, session)
    _check_poses(file, session)
    _check_travel(file, session)
    return session


def _pattern(file: Table) -> tuple[Pattern, dict[str, float]]:
    size = file.table("panel")
    panel = Panel(size.whole("width_px", 1), size.whole("height_px", 1))
    size.finish()
    table = file.table("code")
    name = table.text("pattern", choices=list(PATTERNS))
    numbers = {key: table.whole(key, 1) for key in pattern_keys(name) if table.has(key)}
    decoding = {key: table.number(key) for key in ("min_contrast", "min_confidence") if table.has(key)}
    table.finish()
    try:
        return make_pattern(name, panel, **numbers), decoding
    except BadInputError as error:
        raise table.fail(str(error)) from error


def _eye_box(file: Table, axes: FloatArray) -> EyeBox:
    table = file.table("eye_box")
    centre, size = table.vector("centre_mm", 3), table.vector("size_mm", 3)
    table.finish()
    _check_range(table, "size_mm", size, _EYE_BOX_MM)
    return EyeBox(_MM * axes @ centre, _MM * size)


def _tracking_camera(file: Table, root: Path, axes: FloatArray) -> tuple[SessionCamera, FloatArray]:
    table = file.table("tracking_camera")
    camera = _camera(table, root)
    rotation, translation = table.vectors("rotation", 3), table.vector("translation_mm", 3)
    table.finish()
    if rotation.shape != (3, 3) or not is_rotation(rotation):
        raise table.fail("'rotation' must be a rotation matrix (orthogonal to 1e-6, determinant +1).")
    if np.any(translation):
        _check_range(table, "translation_mm", float(np.linalg.norm(translation)), _CAMERA_PLACE_MM)
    return camera, rigid(axes @ rotation, _MM * axes @ translation)


def _camera(table: Table, root: Path) -> SessionCamera:
    size, bits = (table.whole("width_px", 1), table.whole("height_px", 1)), table.whole("bits", 1)
    if not 8 <= bits <= 16:
        raise table.fail(f"'bits' is {bits}; it must be 8 to 16.")
    if table.has("intrinsics") == table.has("focal_px"):
        raise table.fail(
            "give either 'intrinsics', a folder of pictures of the board, or 'focal_px' and 'opencv_centre_px'."
        )
    if table.has("intrinsics"):
        return SessionCamera(size, bits, intrinsics=tuple(photographs_in(root / table.text("intrinsics"))))
    focal, centre = table.vector("focal_px", 2), table.vector("opencv_centre_px", 2)
    if np.any(focal <= 0):
        raise table.fail(f"'focal_px' is {focal.tolist()}; both must be above 0.")
    distortion = table.vector("distortion", len(DISTORTION_TERMS), [0.0] * len(DISTORTION_TERMS))
    return SessionCamera(size, bits, known=LensCamera(size, focal, centre - OPENCV_PIXEL_SHIFT, distortion))


def _board_photograph(table: Table, root: Path, axes: FloatArray, on_stage: bool = True) -> BoardPhotograph:
    name, pose = str(Path(table.text("photograph"))), table.whole("target_pose")
    stage = _stage(table, axes) if on_stage else np.zeros(3)
    table.finish()
    return BoardPhotograph(root, name, pose, stage)


def _code_set(table: Table, root: Path, axes: FloatArray) -> CodeSet:
    code_set = CodeSet(root / table.text("photographs"), _stage(table, axes))
    table.finish()
    return code_set


def _stage(table: Table, axes: FloatArray) -> FloatArray:
    return np.asarray(_MM * axes @ table.vector("stage_mm", 3))


def _check_range(table: Table, key: str, value: FloatArray | float, limits: tuple[float, float]) -> None:
    low, high = limits
    if np.any(np.asarray(value) < low) or np.any(np.asarray(value) > high):
        raise table.fail(
            f"'{key}' should be between {low:g} and {high:g} mm and is {np.round(value, 6).tolist()}: "
            "is it in another unit? Lengths are millimetres."
        )


def _check_lists(file: Table, session: PhotoSession) -> None:
    for name in ("bare", "tracking", "see_through", "display"):
        if not getattr(session, name):
            raise file.fail(f"'{name}' is empty; a calibration needs its photographs: list them as [[{name}]].")


def _check_poses(file: Table, session: PhotoSession) -> None:
    """Every pose of the target must have been seen by the tracking camera, and one of them without the headset."""
    tracked = {photograph.target_pose for photograph in session.tracking}
    for name, photographs in (("bare", session.bare), ("see_through", session.see_through)):
        for number, photograph in enumerate(photographs, start=1):
            if photograph.target_pose not in tracked:
                raise file.fail(
                    f"[[{name}]] number {number} is of target pose {photograph.target_pose}, of which there is no "
                    "[[tracking]] photograph: nothing says where that target stood."
                )


def _check_travel(file: Table, session: PhotoSession) -> None:
    for name in ("bare", "see_through", "display"):
        stage = np.array([item.stage for item in getattr(session, name)]) / _MM
        travel = float(np.linalg.norm(np.ptp(stage, axis=0)))
        if travel > 0:
            _check_range(file, f"stage_mm (travel of [[{name}]])", travel, _TRAVEL_MM)


def save_photo_session(session: PhotoSession, code: dict[str, Any], board: str) -> Path:
    """Write session.toml into the session's folder, in the axes "opencv", so that `load_photo_session` reads the same.

    Args:
        session: its paths lie below its folder.
        code: the table [code]: `pattern` and its numbers.
        board: name of the board's file in the folder.
    """
    axes = FRAMES["opencv"]
    panel, box = session.pattern.panel, session.eye_box
    pose = session.device_from_tracking
    content = {
        "format": FORMAT,
        "version": VERSION,
        "unit": "mm",
        "frame": "opencv",
        "device": session.device,
        "eye": session.eye,
        "board": board,
        "panel": {"width_px": panel.width_px, "height_px": panel.height_px},
        "code": code,
        "eye_box": {"centre_mm": _in_file(box.centre, axes), "size_mm": _in_file(box.size, np.eye(3))},
        "eyeball_camera": _written_camera(session.eyeball_camera, session.folder),
        "tracking_camera": _written_camera(session.tracking_camera, session.folder)
        | {"rotation": (axes.T @ pose[:3, :3]).tolist(), "translation_mm": _in_file(pose[:3, 3], axes)},
        "bare": _written(session.bare, axes),
        "tracking": [{"photograph": each.name, "target_pose": each.target_pose} for each in session.tracking],
        "see_through": _written(session.see_through, axes),
        "display": [
            {"photographs": session.name_of(each.folder), "stage_mm": _in_file(each.stage, axes)}
            for each in session.display
        ],
    }
    return write_toml(session.folder / FILE, content, "docs/photo-session.md has the format")


def _in_file(value: FloatArray, axes: FloatArray) -> list[float]:
    """Metres to millimetres without the digits that only rounding makes."""
    return [float(number) for number in np.round(axes.T @ value / _MM, 9) + 0.0]


def _written(photographs: Iterable[BoardPhotograph], axes: FloatArray) -> list[dict[str, Any]]:
    return [
        {
            "photograph": each.name,
            "target_pose": each.target_pose,
            "stage_mm": _in_file(each.stage, axes),
        }
        for each in photographs
    ]


def _written_camera(camera: SessionCamera, folder: Path) -> dict[str, Any]:
    keys: dict[str, Any] = {"width_px": camera.size_px[0], "height_px": camera.size_px[1], "bits": camera.bits}
    if camera.known is None:
        return keys | {"intrinsics": str(camera.intrinsics[0].parent.relative_to(folder))}
    known = camera.known
    return keys | {
        "focal_px": known.focal_px.tolist(),
        "opencv_centre_px": (known.centre_px + OPENCV_PIXEL_SHIFT).tolist(),
        "distortion": known.distortion.tolist(),
    }
