"""Photographic session: the content, position and camera of each photograph.

Device frame (OpenXR), metres, radians; cameras have OpenCV's axes. Photographs are referred to by path, not kept in
memory: a session may have thousands. The lists are in the order of taking.
"""

import re
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.captures.boards.board import Board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.errors import BadInputError
from wlr_render.geometry.pose_keys import ROTATION, pose_keys
from wlr_render.io.file_records import DEGREES, ELSEWHERE, LENGTH, POINT, VECTOR, Key, Keys, Quantity, Rule, scaled
from wlr_render.io.input_files import LIMITS
from wlr_render.lenses.lens import Lens
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import BoolArray, FloatArray

CHANNELS = ("red", "green", "blue")
"""Primaries of a panel."""
CODE_ORDERS = ("as shown", "opencv")
"""Orders of a code's photographs in their folder: as in `Pattern.names`, or as in OpenCV's Gray code."""

FAR_MM = 1e4
"""Largest plausible length of a bench; a larger one is in micrometres."""
_DIGITS = 9  # decimals of lengths and angles in session.toml
_DIRECTION = Quantity(lambda value, axes: axes @ value / np.linalg.norm(value), VECTOR.to_file)
_NOT_ZERO = Rule("a vector along the axis, or left out if it is unknown", lambda value: bool(np.any(value)))
_REGIONS = Rule(
    "lists [u0, v0, u1, v1] with u0 below u1 and v0 below v1", lambda value: bool(np.all(value[:, :2] < value[:, 2:]))
)


def _pose_within(most_mm: float) -> Keys:
    """Return the keys of a camera's or board's pose; both have OpenCV's axes in any file."""
    least_mm = 0.5  # least length of a translation; a shorter one is in metres
    rule = Rule(
        f"0, or {least_mm:g} to {most_mm:g} mm long: lengths are millimetres",
        lambda value: bool(not np.any(value) or least_mm <= np.linalg.norm(value) <= most_mm),
    )
    return pose_keys(
        Key("rotation", VECTOR, shape=(3, 3), rule=ROTATION),
        Key("translation_mm", POINT, shape=(3,), digits=_DIGITS, rule=rule),
    )


@dataclass(frozen=True)
class CodeTable:
    """Keys of [code] except the pattern with its parameters, and `DecodeOptions`.

    Attributes:
        order: order of the photographs of a code, one of `CODE_ORDERS`.
        manifest: file that assigns pictures to the photographs of a code, or None.
    """

    order: Annotated[str, Key(choices=CODE_ORDERS)] = CODE_ORDERS[0]
    manifest: Path | None = None


@dataclass(frozen=True)
class StageTable:
    """Keys of [stage] except its axes: "none" without a stage, the tolerance of positions, the frame of the axes."""

    kind: Literal["linear", "none"] = "linear"
    place_tolerance: Annotated[float, Key("place_tolerance_um", scaled(1e-6), least=0, most=1000, digits=_DIGITS)] = (
        2e-6
    )
    directions_in: Literal["device", "camera"] = "device"


CAMERA_POSE = _pose_within(1000.0)
"""Keys of the tracking camera's pose."""
GAUGE = Key(
    "gauge",
    type=str,
    rule=Rule(
        '"camera", or "target 0" with the number of a target pose',
        lambda value: re.fullmatch(r"camera|target \d{1,7}", value) is not None,
    ),
)
"""Key for the choice of the device frame; see `PhotoSession`."""
POSE_SIGMA = Keys(
    (
        Key("sigma_deg", DEGREES, above=0, most=180, digits=_DIGITS),
        Key("sigma_mm", LENGTH, above=0, most=FAR_MM, digits=_DIGITS),
    ),
    lambda *sigma: sigma,
    lambda sigma: sigma,
)
"""Keys of the standard deviations of a pose: rotation, radians, and translation, metres."""


@dataclass(frozen=True, eq=False)
class SessionCamera:
    """A camera of the session.

    Attributes:
        size_px: width and height of its photographs.
        format: conversion of its files to linear values.
        intrinsics: photographs of the board from many sides, without the headset, for its calibration.
        calibrated: the camera if it is already calibrated, else None.
        lens: lens model to fit, a key of `lens_camera.LENS_KINDS`, or "auto": chosen by cross-validation. "auto" if the
            lens is calibrated.
        calibrated_sigma: (P,) standard deviations of `calibrated.values`: fx, fy, cx, cy in pixels, then the
            distortion; None if the lens is stated as exact.
        lens_file: the file that `calibrated` was read from, else None.
    """

    size_px: tuple[int, int]
    format: PhotographFormat
    intrinsics: tuple[Path, ...] = ()
    calibrated: Lens | None = None
    lens: str = "auto"
    calibrated_sigma: FloatArray | None = None
    lens_file: Path | None = None


@dataclass(frozen=True, eq=False)
class StageAxis:
    """An axis of the stage that carries the eyeball camera.

    Attributes:
        kind: "linear" or "rotary".
        direction: (3,) unit vector of travel, or of right-handed rotation; None if unknown.
        direction_sigma: standard deviation of `direction` about each perpendicular axis, radians; None if not stated.
        pivot: (3,) a point on a rotary axis at the stage's reference, metres; None if unknown.
        is_in_camera: True if direction and pivot are in the frame of the eyeball camera in its first mounting, at the
            stage's reference; otherwise they are in the device frame.
    """

    kind: Annotated[Literal["linear", "rotary"], Key(always=True)] = "linear"
    direction: Annotated[FloatArray | None, Key("", _DIRECTION, shape=(3,), rule=_NOT_ZERO)] = None
    direction_sigma: Annotated[float | None, Key("direction_sigma_deg", DEGREES, above=0, most=180, digits=_DIGITS)] = (
        None
    )
    pivot: Annotated[FloatArray | None, Key("pivot_mm", POINT, shape=(3,), most=FAR_MM, digits=_DIGITS)] = None
    is_in_camera: Annotated[bool, ELSEWHERE] = False

    def __post_init__(self) -> None:
        if self.direction_sigma is not None and self.direction is None:
            raise BadInputError("'direction_sigma_deg' is given without 'direction'; give both, or neither.")
        if self.pivot is not None and self.kind == "linear":
            raise BadInputError("'pivot_mm' is for rotary axes; remove it, or write kind = \"rotary\".")


@dataclass(frozen=True, eq=False)
class StageDescription:
    """The stage that carries the eyeball camera; readings (m,) are metres or radians, in the order of `axes`."""

    axes: tuple[StageAxis, ...] = (StageAxis(), StageAxis(), StageAxis())

    @property
    def units(self) -> FloatArray:
        """Metres per millimetre of each linear axis, radians per degree of each rotary axis, (m,)."""
        return np.array([1e-3 if axis.kind == "linear" else np.pi / 180 for axis in self.axes])


@dataclass(frozen=True, eq=False)
class GivenPose:
    """A target pose that session.toml states.

    Attributes:
        device_from: (4, 4) device_from_board.
        sigma: standard deviations of rotation, radians, and translation, metres, per axis.
        board: the board at this pose, if it differs from the session's.
        board_file: name of that board's file in the session's folder.
    """

    device_from: Annotated[FloatArray, _pose_within(50000.0)]
    sigma: Annotated[tuple[float, float], POSE_SIGMA]
    board: Board | None = None
    board_file: Annotated[str | None, Key("board")] = None


@dataclass(frozen=True, eq=False)
class SessionEntry:
    """A photograph, or a set of photographs, from one camera position.

    Attributes:
        folder: folder of the session, or of the set.
        stage: (m,) stage reading, metres or radians; None without a stage, and for the tracking camera.
        place: name of the camera position; photographs of one position were taken without moving the camera; "" for the
            tracking camera.
        orientation: index of the camera's mounting orientation on the stage.
        eye: "left" or "right".
        time_s: time stamp, seconds from any origin; None if unknown.
        temperature_c: temperature of the bench, degrees Celsius; None if unknown.
    """

    folder: Annotated[Path, ELSEWHERE]
    _: KW_ONLY
    stage: Annotated[FloatArray | None, Key(shape=(-1,), digits=_DIGITS)] = None
    place: str = ""
    orientation: Annotated[int, Key(most=LIMITS.index)] = 0
    eye: Annotated[str, Key(always=True)] = "right"
    time_s: Annotated[float | None, Key(most=LIMITS.time_s)] = None
    temperature_c: Annotated[float | None, Key(least=LIMITS.temperature_c[0], most=LIMITS.temperature_c[1])] = None

    @property
    def path(self) -> Path:
        """Path of the photograph, or of the set's folder."""
        return self.folder


@dataclass(frozen=True, eq=False)
class BoardPhotograph(SessionEntry):
    """A photograph of the board, the target.

    Attributes:
        name: path from the session's folder, the photograph's name in reports.
        target_pose: index of the target's position.
        regions: (n, 4) least u, v and greatest u, v of the image regions that show the target past the optics,
            pixels from the outer corner of the top-left pixel; None for the whole picture.
        other_regions: (n, 4) regions of a photograph through the optics that do not show the target through them.
    """

    name: Annotated[str, Key("photograph")]
    target_pose: Annotated[int, Key(most=LIMITS.index)]
    regions: Annotated[FloatArray | None, Key("region_px", shape=(-1, 4), rule=_REGIONS)] = None
    other_regions: FloatArray | None = None

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / self.name

    def counts(self, pixel: FloatArray) -> BoolArray:
        """Return the mask (n,) of pixels (n, 2) in the `regions` of this entry and not in its `other_regions`."""
        whole = np.ones(len(pixel), dtype=bool) if self.regions is None else _in_regions(pixel, self.regions)
        return whole if self.other_regions is None else whole & ~_in_regions(pixel, self.other_regions)


def _in_regions(pixel: FloatArray, regions: FloatArray) -> BoolArray:
    inside = np.zeros(len(pixel), dtype=bool)
    for region in regions:
        inside |= np.all((pixel >= region[:2]) & (pixel <= region[2:]), axis=1)
    return inside


@dataclass(frozen=True, eq=False)
class CodeSet(SessionEntry):
    """Photographs of a pattern on the panel from one camera position; their names are in the order of showing.

    Attributes:
        channel: the primary that the panel showed, one of `CHANNELS`; None for white.
    """

    folder: Annotated[Path, Key("photographs")]
    channel: Annotated[str | None, Key(choices=CHANNELS)] = None


@dataclass(frozen=True, eq=False)
class SessionPanel:
    """The panel of an eye.

    Attributes:
        pattern: pattern that the panel showed.
        primary_offsets: channel -> (2,) position of that primary in the pixel relative to the pixel's centre, pixels.
    """

    pattern: Pattern
    primary_offsets: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PhotoSession:
    """Content of a session.toml.

    Attributes:
        folder: folder of session.toml; names of photographs in reports are relative to it.
        device: name of the headset.
        eyes: eyes of the session: "left", "right" or both.
        eye_boxes: eye -> eye box, device frame.
        panels: eye -> its panel; one object for both eyes if they are equal.
        decoding: thresholds for accepting a decoded pixel.
        board: the printed target.
        eyeball_camera: the camera in place of the eye.
        see_through: photographs of the target by the eyeball camera, through the optics.
        display: photographs of the panel by the eyeball camera.
        bare: photographs of the target by the eyeball camera, without the headset.
        beside: photographs of the target by the eyeball camera, past the optics of the mounted headset.
        tracking: photographs of the target by the tracking camera.
        tracking_camera: the headset's tracking camera, if it has one.
        device_from_tracking: (4, 4) its pose, if it has one.
        tracking_sigma: standard deviations of that pose, radians and metres; None if it is stated as exact.
        stage: stage of the eyeball camera; None for a robot arm or a hand, where camera positions are free.
        targets: index -> target pose in session.toml.
        gauge: "target N": the device frame is the board's frame at target pose N, with OpenXR's axes. "camera": it is
            the eyeball camera's frame at the stage's reference, with OpenXR's axes, shifted to match the stated eye
            box. None: tracking camera or `targets` fix it.
        code: order of the photographs of a code, and their manifest.
        place_tolerance: largest difference of stage readings at one position, metres.
    """

    folder: Path
    device: str
    eyes: tuple[str, ...]
    eye_boxes: Mapping[str, EyeBox]
    panels: Mapping[str, SessionPanel]
    decoding: DecodeOptions
    board: Board
    eyeball_camera: SessionCamera
    see_through: tuple[BoardPhotograph, ...] = ()
    display: tuple[CodeSet, ...] = ()
    bare: tuple[BoardPhotograph, ...] = ()
    beside: tuple[BoardPhotograph, ...] = ()
    tracking: tuple[BoardPhotograph, ...] = ()
    tracking_camera: SessionCamera | None = None
    device_from_tracking: FloatArray | None = None
    tracking_sigma: tuple[float, float] | None = None
    stage: StageDescription | None = StageDescription()
    targets: Mapping[int, GivenPose] = field(default_factory=dict)
    gauge: str | None = None
    code: CodeTable = CodeTable()
    place_tolerance: float = StageTable.place_tolerance

    @property
    def eye(self) -> str:
        """Eye of a session of one eye; ValueError for both."""
        (eye,) = self.eyes
        return eye

    @property
    def eye_box(self) -> EyeBox:
        """Eye box of a session of one eye; ValueError for both."""
        return self.eye_boxes[self.eye]

    @property
    def pattern(self) -> Pattern:
        """Pattern of the panel; ValueError if the two eyes' panels differ."""
        (panel,) = {id(each): each for each in self.panels.values()}.values()
        return panel.pattern

    @property
    def gauge_target(self) -> int | None:
        """Index of the target pose whose frame is the device frame, or None."""
        named = self.gauge is not None and self.gauge.startswith("target ")
        return int(str(self.gauge).removeprefix("target ")) if named else None

    def board_of(self, target_pose: int) -> Board:
        """Return the board at a target pose."""
        given = self.targets.get(target_pose)
        return self.board if given is None or given.board is None else given.board

    def for_eye(self, eye: str) -> "PhotoSession":
        """Return the session of one eye: photographs of its panel and through its optics, and all shared ones."""
        return replace(
            self,
            eyes=(eye,),
            eye_boxes={eye: self.eye_boxes[eye]},
            panels={eye: self.panels[eye]},
            see_through=tuple(each for each in self.see_through if each.eye == eye),
            display=tuple(each for each in self.display if each.eye == eye),
        )

    def name_of(self, path: Path) -> str:
        """Return the name of a photograph or folder in reports."""
        return str(path.relative_to(self.folder)) if path.is_relative_to(self.folder) else str(path)
