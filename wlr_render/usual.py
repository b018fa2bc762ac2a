"""Sizes of the errors of ordinary equipment: one table that priors, checks, budgets and simulators use by name.

docs/equipment.md prints the table with the modules that use each row: where an estimator and a simulator share a row,
the simulated bench has exactly the size that the estimator expects.

A size is a standard deviation per axis, or the root mean square of a curve.
"""

from dataclasses import dataclass
from math import radians


@dataclass(frozen=True)
class Size:
    """Size of one kind of error.

    Attributes:
        value: size in `unit`.
        unit: "m", "rad", "arcmin", "px" and so on; "1" for a ratio.
        source: source of the value: data sheets, our measurement, a publication or an assumption.
        log_sigma: standard deviation of the natural logarithm of the size between benches, for a prior of the size
            itself; 0 where the value is used as a constant.
    """

    value: float
    unit: str
    source: str
    log_sigma: float = 0.0

    @property
    def milli(self) -> float:
        """The value in thousandths of its unit, e.g. millimetres for metres."""
        return round(1e3 * self.value, 9)

    @property
    def micro(self) -> float:
        """The value in millionths of its unit, e.g. micrometres for metres."""
        return round(1e6 * self.value, 9)


_BY_THREE, _BY_E = 1.2, 1.0  # sigmas of logarithms: benches differ by a factor of 3.3, or of 2.7

# The stage that carries the camera: what estimators expect.
STAGE_REPEATABILITY_M = Size(
    3e-6,
    "m",
    "data sheet of one axis with a lead screw: 1 um (Optimal Engineering Systems); assumption: three axes and a load",
    _BY_THREE,
)
STAGE_TURN_RAD = Size(
    1e-5, "rad", "assumption: the repeatability over 0.3 m, the length of a stack of stages and its bracket", _BY_THREE
)
STAGE_SMOOTH_SHIFT_M = Size(
    3e-6, "m", "assumption: straightness is a part of the accuracy, 10 um (same data sheet); each term", _BY_THREE
)
STAGE_SMOOTH_TURN_RAD = Size(
    5e-5, "rad", "assumption: pitch, yaw and roll of 25 to 150 urad over the travel; each term", _BY_THREE
)
STAGE_SCREW_M = Size(
    3e-6, "m", "Dover Motion, motion control handbook: precision lead screws err by 10 um, peak to peak, a turn", _BY_E
)
STAGE_BACKLASH_M = Size(
    3e-6, "m", "assumption: directions of travel differ by 5 um with an anti-backlash nut; about half of it", _BY_E
)
STAGE_SCALE = Size(
    1e-3, "1", "assumption: twice the lead error of commercial screws, 4e-4 (Dover Motion, motion control handbook)"
)
STAGE_DIRECTION_RAD = Size(radians(0.2), "rad", "assumption: directions are stated as dowel pins and squares give them")
STAGE_PIVOT_M = Size(1e-3, "m", "assumption: a stated pivot is measured with a rule")
SESSION_REPEATABILITY_M = Size(
    8e-6,
    "m",
    "assumption: between stages with motors (3 um) and micrometers read by eye (20 um), as sessions to diagnose have "
    "either; figures of diagnoses in docs/ were made with it",
    _BY_THREE,
)
SESSION_TURN_RAD = Size(25e-6, "rad", "assumption: as SESSION_REPEATABILITY_M, over 0.3 m", _BY_THREE)

# Cameras.
CAMERA_NOISE_ARCMIN = Size(
    0.25, "arcmin", "assumption: a quarter of a pixel of 1', worse than the dots and codes of our photographs"
)
CAMERA_DRIFT_ARCMIN = Size(
    0.1, "arcmin", "assumption: 0.1 px of a camera with 1' a pixel, rms in a session while it warms up", _BY_E
)
CAMERA_FOCUS_BREATHING = Size(
    2e-4, "1", "assumption: a fixed lens; change of the focal length between the target's distances"
)
CAMERA_LENS_PX = Size(
    0.05,
    "px",
    "assumption: half of what models of few terms leave of real lenses, rms (Schoeps et al., CVPR 2020)",
    _BY_E,
)
CAMERA_SYSTEMATIC_PX = Size(
    0.01, "px", "measured: fits of simulated sessions find 0.008 to 0.017 px that noise does not explain"
)
DOT_NOISE_PX = Size(0.02, "px", "assumption: centre of a dot of 10 to 30 camera pixels")
CODE_NOISE_PX = Size(0.03, "px", "assumption: a position decoded from fringes, in panel pixels")

# Boards, printed on paper or on a plate.
BOARD_PRINT_M = Size(
    5e-5,
    "m",
    "assumption: half of the line accuracy of plotters, 0.1 mm (HP DesignJet data sheets); a smooth field",
    _BY_E,
)
BOARD_HEIGHT_M = Size(
    1e-4,
    "m",
    "assumption: composite panels are flat to 0.1 to 0.3 mm, peak to valley; rms without bow and twist",
    _BY_E,
)
BOARD_DOT_M = Size(2e-5, "m", "assumption: half of a printer's dot at 600 dpi")
BOARD_FLATNESS_M = Size(3e-4, "m", "assumption: bow and twist at the edge of a plate of 4 mm that stands upright")
BOARD_SCALE = Size(
    5e-4, "1", "assumption: half of the line accuracy of plotters, 0.1 % (HP DesignJet data sheets); x and y each"
)
BOARD_STRETCH = Size(
    1e-4, "1", "assumption: a board of 0.3 m that bends by 2 mm in the hand looks shorter by this", _BY_THREE
)

# The simulated bench. It also uses rows of the groups above; these rows differ from what estimators expect.
SIMULATED_REPEATABILITY_M = Size(5e-6, "m", "assumption: worse than STAGE_REPEATABILITY_M; docs/ has figures of it")
SIMULATED_SMOOTH_TURN_RAD = Size(
    1e-4, "rad", "assumption: pitch, yaw and roll of 25 to 150 urad; rms of the curve of each along each axis"
)
SIMULATED_SMOOTH_SHIFT_M = Size(2e-6, "m", "assumption: within STAGE_SMOOTH_SHIFT_M; rms of the curve")
SIMULATED_ARM_M = Size(0.05, "m", "assumption: height of the camera over the carriage")
SIMULATED_READBACK_M = Size(5e-7, "m", "assumption: linear encoders of 0.1 to 1 um")
SIMULATED_SKEW_RAD = Size(1e-3, "rad", "assumption: four times the skew of commercial tables, 50 arcsec (Dover Motion)")
SIMULATED_CREEP_M = Size(3e-6, "m", "assumption: 0.5 K in a stack of 0.25 m of aluminium (23e-6 a kelvin)")
SIMULATED_BOW_M = Size(2e-4, "m", "assumption: within BOARD_FLATNESS_M, corners over the middle")
SIMULATED_TWIST_M = Size(5e-5, "m", "assumption: within BOARD_FLATNESS_M")
SIMULATED_SCALE = Size(2e-4, "1", "assumption: within BOARD_SCALE; the whole board")
SIMULATED_DOT_M = Size(1e-5, "m", "assumption: within BOARD_DOT_M")
SIMULATED_LENS_PX = Size(0.08, "px", "assumption: what five Brown terms leave of a lens of eight, rms")
SIMULATED_DECENTRING = Size(3e-4, "1", "assumption: p1 and p2 of a lens with centring errors of some 10 um")
SIMULATED_EXTRINSICS_M = Size(3e-4, "m", "assumption: a tracking camera placed by its drawing")
SIMULATED_EXTRINSICS_DEG = Size(0.05, "deg", "assumption: 0.3 mm over 0.3 m, the width of a headset's frame")
SIMULATED_BLACK_CLIP = Size(0.02, "1", "assumption: an offset of 5 of 255 that was set too low")
SIMULATED_GAMMA = Size(0.02, "1", "assumption: sensors are linear to 1 or 2 %")
SIMULATED_VIBRATION_PX = Size(0.15, "px", "assumption: blur of an exposure in a building, standard deviation")
SIMULATED_STRAY_LIGHT = Size(0.01, "1", "assumption: veiling glare of coated lenses, 0.5 to 3 %")

# Trackers of a headset, and its wearer.
EYE_NOISE_DEG = Size(0.20, "deg", "measured: scatter of gaze during fixation, in the data of docs/measured-data.md")
EYE_BIAS_DEG = Size(0.84, "deg", "measured: median gaze error in the same data, over both axes")
EYE_LATENCY_S = Size(
    0.045, "s", "Stein et al. 2021, i-Perception 12(1): the fastest of three headsets (45 to 81 ms), without prediction"
)
HEAD_NOISE_DEG = Size(0.02, "deg", "assumption: visual-inertial trackers at rest")
HEAD_NOISE_M = Size(5e-4, "m", "assumption: visual-inertial trackers at rest")
HEAD_LATENCY_S = Size(2e-3, "s", "assumption: what prediction and late warp leave")
HEAD_SPEED_DEG_S = Size(15.0, "deg/s", "assumption: a wearer who looks around, rms per axis")
HEAD_SPEED_M_S = Size(0.1, "m/s", "assumption: a wearer who looks around, rms per axis")
