"""Imperfections of a simulated photographic bench, with the sizes of ordinary equipment."""

from dataclasses import asdict, dataclass, replace
from typing import Literal

from wlr_render import usual
from wlr_render.errors import BadInputError

LensKind = Literal["brown", "rational", "thin-prism", "fisheye"]


@dataclass(frozen=True)
class BenchImperfections:
    """Sizes of the errors of a photographic bench, with signs and directions drawn from the bench's seed.

    "rms" is the root mean square over the range of one stage axis; "random" is a standard deviation.

    Attributes:
        turn_urad: rms pitch, yaw and roll (each) of the carriage along each stage axis, as cubic curves.
        turn_jitter_urad: random rotation of each visit, per axis.
        straightness_um: rms departure from a straight line along each stage axis, in each direction.
        arm_mm: lever arm from the carriage's centre of rotation to the pupil, which the rotations displace.
        repeatability_um: random displacement of each visit, per axis.
        readback_um: random error of the reading that session.toml states, per axis.
        axes_skew_mrad: departure of each pair of stage axes from a right angle.
        creep_um: thermal displacement of the stage from the first photograph to the last, exponentially decaying.
        bow_mm: height of the board's corners over its middle; see `printed_board`.
        twist_mm: height of the board's corners due to twist, of alternating sign.
        anisotropy: relative difference of the print's scales in y and x.
        scale_error: relative error of the print's overall scale.
        dot_error_um: random displacement of each dot on the board, per axis.
        lens: kind of the true eyeball lens and tracking lens, see `lenses.lens_camera.LENS_KINDS`.
        lens_px: rms residual in pixels per axis of a fit of the five Brown terms to a "rational" or "thin-prism" lens.
        decentring: tangential distortion added to each lens, p1 and p2 each.
        focus_breathing: relative change of the eyeball camera's focal length between the farthest and nearest target.
        extrinsics_mm: random error of the stated position of the tracking camera, per axis.
        extrinsics_deg: random error of the stated rotation of the tracking camera, per axis.
        black_clip: fraction of full scale by which the sensor's black level is too low; darker pixels become 0.
        gamma_error: nonlinearity of the sensors' response, as the departure of gamma from 1.
        vibration_px: standard deviation of the motion blur of each photograph, along a random direction.
        stray_light: fraction of the light spread over the picture (veiling glare).
    """

    turn_urad: float = usual.SIMULATED_SMOOTH_TURN_RAD.micro
    turn_jitter_urad: float = usual.STAGE_TURN_RAD.micro
    straightness_um: float = usual.SIMULATED_SMOOTH_SHIFT_M.micro
    arm_mm: float = usual.SIMULATED_ARM_M.milli
    repeatability_um: float = usual.SIMULATED_REPEATABILITY_M.micro
    readback_um: float = usual.SIMULATED_READBACK_M.micro
    axes_skew_mrad: float = usual.SIMULATED_SKEW_RAD.milli
    creep_um: float = usual.SIMULATED_CREEP_M.micro
    bow_mm: float = usual.SIMULATED_BOW_M.milli
    twist_mm: float = usual.SIMULATED_TWIST_M.milli
    anisotropy: float = usual.BOARD_SCALE.value
    scale_error: float = usual.SIMULATED_SCALE.value
    dot_error_um: float = usual.SIMULATED_DOT_M.micro
    lens: LensKind = "rational"
    lens_px: float = usual.SIMULATED_LENS_PX.value
    decentring: float = usual.SIMULATED_DECENTRING.value
    focus_breathing: float = usual.CAMERA_FOCUS_BREATHING.value
    extrinsics_mm: float = usual.SIMULATED_EXTRINSICS_M.milli
    extrinsics_deg: float = usual.SIMULATED_EXTRINSICS_DEG.value
    black_clip: float = usual.SIMULATED_BLACK_CLIP.value
    gamma_error: float = usual.SIMULATED_GAMMA.value
    vibration_px: float = usual.SIMULATED_VIBRATION_PX.value
    stray_light: float = usual.SIMULATED_STRAY_LIGHT.value

    def __post_init__(self) -> None:
        for name, value in self._sizes().items():
            if not 0.0 <= value < float("inf"):
                raise BadInputError(f"The imperfection '{name}' is {value}; give a finite size of 0 or more.")
        if not (self.gamma_error < 1.0 and self.black_clip < 1.0 and self.anisotropy < 0.1 and self.scale_error < 0.1):
            raise BadInputError(
                f"{self} is impossible; 'gamma_error' and 'black_clip' must be below 1, 'anisotropy' and 'scale_error' "
                "below 0.1."
            )

    @classmethod
    def none(cls) -> "BenchImperfections":
        """Return the perfect bench with lenses of five Brown terms."""
        return cls().scaled(0.0)

    @property
    def of_photographs(self) -> "BenchImperfections":
        """Imperfections of photographs, extrinsics and axes only, since a `Workshop` has stage, board and lenses."""
        stage = {"turn_urad": 0.0, "turn_jitter_urad": 0.0, "straightness_um": 0.0, "repeatability_um": 0.0}
        board = {"bow_mm": 0.0, "twist_mm": 0.0, "anisotropy": 0.0, "scale_error": 0.0, "dot_error_um": 0.0}
        return replace(self, **stage, **board, creep_um=0.0, lens="brown")

    def scaled(self, factor: float) -> "BenchImperfections":
        """Return all sizes multiplied by a factor of 0 or more; with 0, the lens is "brown"."""
        return BenchImperfections(
            **{name: factor * size for name, size in self._sizes().items()}, lens=self.lens if factor else "brown"
        )

    def _sizes(self) -> dict[str, float]:
        return {name: value for name, value in asdict(self).items() if name != "lens"}
