"""Options of the job `export`, checked before any work."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.exports.formats import FormatName, format_of
from wlr_render.jobs import limits
from wlr_render.jobs.options import (
    Against,
    Eyes,
    NoEffect,
    OnlyWith,
    Options,
    Range,
    described,
    described_size,
    option_group,
)
from wlr_render.numerics.arrays import FloatArray

_PUPIL = option_group("Pupil positions", 1)
_COLOURS = option_group("Colours", 2)
_SOURCE = option_group("Source picture", 3)
_FRAMES_PER_SECOND = 30.0
_POSITION, _POSITIONS = 3, 6
"""Numbers of one pupil position, and of two."""


@dataclass(frozen=True)
class ExportOptions(Options):
    """Options of `export`."""

    headset: Annotated[
        str, described("Device, factory calibration or model file (with --red-model: the model of green light).")
    ]
    _: KW_ONLY
    format: Annotated[FormatName, described("File format.")]
    eye: Annotated[Eyes, described("Eyes to export.")] = "right"
    depth_m: Annotated[
        float | None,
        described(
            "Depth from the source camera, in metres, for which the maps are right (default: infinity).", group=_SOURCE
        ),
        limits.DEPTH_M,
    ] = None
    viewpoint_mm: Annotated[
        tuple[float, ...] | None,
        described(
            "Pupil position x y z in the device frame, in mm; with --eye both, the left pupil, then the right one "
            "(default: centre of the eye box).",
            flag=True,
            many=True,
            group=_PUPIL,
        ),
        Range(at_least=-1000, at_most=1000),
    ] = None
    pupils: Annotated[
        int | None,
        described("A grid of N x N pupil positions, over the width and height of the eye box.", group=_PUPIL),
        Range(at_least=2, at_most=31),
    ] = None
    eye_track: Annotated[
        Path | None,
        described(
            "Eye trajectory (docs/files.md) or OpenXR recording (docs/openxr.md): a map for each frame.", group=_PUPIL
        ),
    ] = None
    fps: Annotated[
        float | None,
        described(f"Frames per second of --eye-track (default: {_FRAMES_PER_SECOND:g}).", group=_PUPIL),
        Range(above=0, at_most=1000),
        OnlyWith("eye_track"),
    ] = None
    frame_limit: Annotated[
        int | None,
        described("Maximum number of frames along --eye-track (default: all).", name="--frames", group=_PUPIL),
        Range(at_least=1, at_most=limits.FRAMES),
        OnlyWith("eye_track"),
    ] = None
    per_colour: Annotated[
        bool,
        described("Separate maps for red, green and blue; a device is traced in all three.", flag=True, group=_COLOURS),
    ] = False
    red_model: Annotated[
        Path | None,
        described("Model file in red light; needs --blue-model.", group=_COLOURS),
        OnlyWith("blue_model"),
    ] = None
    blue_model: Annotated[
        Path | None,
        described("Model file in blue light; needs --red-model.", group=_COLOURS),
        OnlyWith("red_model"),
    ] = None
    resolution: Annotated[
        float,
        described("Resolution of the source picture; 1: about as fine as the panel.", group=_SOURCE),
        Range(above=0, at_most=4),
    ] = 1.0
    source_size: Annotated[
        tuple[int, int] | None,
        described_size(
            "Pixels of the source picture, e.g. 1920x1080, in place of --resolution.", optional=True, group=_SOURCE
        ),
        limits.PIXELS,
    ] = None
    source_axes: Annotated[
        Literal["field", "device"] | None,
        described(
            "Axes of the source camera: towards the middle of the field of view, or the device's own (default: field; "
            "monado: device).",
            group=_SOURCE,
        ),
    ] = None
    source_camera: Annotated[
        Literal["viewpoint", "nearest"],
        described(
            "Position of the source camera: the viewpoint, or the point nearest to the bent rays.", group=_SOURCE
        ),
    ] = "viewpoint"
    out: Annotated[Path, described("Output folder."), NoEffect()] = Path("out/export")
    against: Against = None

    def __post_init__(self) -> None:
        """Check that the options are compatible and that the format supports them."""
        super().__post_init__()
        moving = [
            flag
            for flag, value in (
                ("--viewpoint-mm", self.viewpoint_mm),
                ("--pupils", self.pupils),
                ("--eye-track", self.eye_track),
            )
            if value is not None
        ]
        if len(moving) > 1:
            raise BadInputError(f"{' and '.join(moving)} exclude each other; give one of them.")
        count, due = len(self.viewpoint_mm or ()), _POSITIONS if self.eye == "both" else _POSITION
        if self.viewpoint_mm is not None and count != due:
            whose = "x y z of the left eye, then of the right" if self.eye == "both" else f"x y z of the {self.eye} eye"
            raise BadInputError(f"--viewpoint-mm has {count} numbers; give {due}: {whose}.")
        if self.source_size is not None and self.resolution != 1.0:
            raise BadInputError("--resolution has no effect with --source-size; leave out one of them.")
        _require_held(self)
        if format_of(self.format).holds.every_pupil and (moving or self.source_camera != "viewpoint"):
            raise BadInputError(
                f"{moving[0] if moving else '--source-camera'} has no effect with {self.format}: its file serves every "
                "position of the pupil and of the source camera; leave it out."
            )

    @property
    def frames_per_second(self) -> float:
        """Frames per second of the eye trajectory."""
        return self.fps or _FRAMES_PER_SECOND

    def viewpoint_m(self, eye: str) -> FloatArray | None:
        """Return the chosen pupil position (3,) of an eye, in metres; None if none is chosen."""
        if self.viewpoint_mm is None:
            return None
        return 1e-3 * np.array(self.viewpoint_mm[-_POSITION:] if eye == "right" else self.viewpoint_mm[:_POSITION])

    @property
    def has_colours(self) -> bool:
        """True if red, green and blue have separate maps."""
        return self.per_colour or self.red_model is not None


def _require_held(options: ExportOptions) -> None:
    """Reject options that the format cannot store.

    Raises:
        BadInputError: the message names the option.
    """
    holds = format_of(options.format).holds
    if holds.every_depth and options.depth_m is not None:
        raise BadInputError(
            f"--depth-m has no effect with {options.format}: its files hold rays, which fit every depth; leave it out."
        )
    if options.has_colours and not holds.colours:
        raise BadInputError(
            f"{options.format} has one map for all colours; leave out --per-colour, --red-model and --blue-model, or "
            "choose a format with maps by colour, e.g. stmap."
        )
    if not holds.asymmetric_field and options.source_axes == "field":
        raise BadInputError(f"{options.format} takes the device's axes only; leave out --source-axes.")
    if holds.both_eyes and options.eye != "both":
        raise BadInputError(
            f"{options.format} holds both eyes in one file; give --eye both, and a headset that has two "
            "(also_mirrored = true in a device file adds the other)."
        )
    if not holds.pupils and (options.pupils or options.eye_track):
        raise BadInputError(
            f"{options.format} has one pupil position; leave out --pupils and --eye-track, or choose a format that "
            "holds several, e.g. stmap."
        )
