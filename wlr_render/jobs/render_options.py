"""Options of `render`."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.draw.frame_layers import Layer
from wlr_render.draw.painters import RESOLUTION, SUPERSAMPLE
from wlr_render.errors import BadInputError
from wlr_render.jobs import limits
from wlr_render.jobs.options import (
    WORK,
    WORKERS,
    Against,
    Backend,
    Eyes,
    NoEffect,
    OnlyWith,
    Range,
    Scheduler,
    Seed,
    SpreadOptions,
    described,
    option_group,
)

Layout = Literal["webdataset", "huggingface"]
_MOTION = option_group("Motion", 1)
_DRAWING = option_group("Drawing", 2)
_COLOURS = option_group("Colours", 3)
_ALSO = option_group("Further files", 4)


@dataclass(frozen=True)
class RenderOptions(SpreadOptions):
    """Options of `render`."""

    headset: Annotated[
        str, described("Device, factory calibration or model file (with --red-model: the model of green light).")
    ]
    scene: Annotated[str, described("A shipped scene, a scene file or a mesh.")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to draw.")] = "right"
    head: Annotated[
        Path | None,
        described(
            "Head trajectory: TUM, EuRoC, a table with named columns, or an OpenXR recording (default: a head at rest "
            "at the world's origin).",
            group=_MOTION,
        ),
    ] = None
    eye_track: Annotated[
        Path | None,
        described(
            "Eye trajectory, a table of pupils with named columns, or an OpenXR recording (default: pupils at rest at "
            "the centres of the eye boxes).",
            group=_MOTION,
        ),
    ] = None
    frames_per_second: Annotated[
        float,
        described(
            "Frames per second; frames cover the time span that both trajectories share.", name="--fps", group=_MOTION
        ),
        Range(above=0, at_most=1000),
    ] = 30.0
    frame_limit: Annotated[
        int | None,
        described(
            "Maximum number of frames along --head or --eye-track (default: all).", name="--frames", group=_MOTION
        ),
        Range(at_least=1, at_most=limits.FRAMES),
        NoEffect(),
    ] = None
    method: Annotated[
        Literal["raster", "raytrace", "pathtrace"],
        described(
            "Rendering method: an intermediate image that is warped, a ray for each pixel, or path tracing with "
            "Mitsuba (docs/renderers.md).",
            group=_DRAWING,
        ),
    ] = "raster"
    supersample: Annotated[
        int,
        described(
            "Rays per pixel and axis where neighbours differ by more than 8 codes; elsewhere one (raytrace only).",
            group=_DRAWING,
        ),
        Range(1, 12),
        OnlyWith("method", ("raytrace",)),
    ] = SUPERSAMPLE
    shadows: Annotated[
        bool,
        described("Draw shadows (raytrace only).", flag=True, group=_DRAWING),
        OnlyWith("method", ("raytrace",)),
    ] = False
    samples: Annotated[
        int,
        described("Paths per pixel (pathtrace only).", group=_DRAWING),
        Range(1, 1 << 16),
        OnlyWith("method", ("pathtrace",)),
    ] = 64
    bounces: Annotated[
        int,
        described("Reflections of light between surfaces; 0: direct light (pathtrace only).", group=_DRAWING),
        Range(0, 64),
        OnlyWith("method", ("pathtrace",)),
    ] = 4
    seed: Annotated[Seed, OnlyWith("method", ("pathtrace",))] = 0
    materials: Annotated[
        Literal["own", "gltf"],
        described(
            "Raster shading: that of the ray tracer, or pyrender's for matte glTF materials (needs OpenGL).",
            group=_DRAWING,
        ),
        OnlyWith("method", ("raster",)),
    ] = "own"
    resolution: Annotated[
        float,
        described(
            "Resolution of the intermediate image along each axis; 1: about as many pixels as the panel, with jagged "
            "edges (raster only).",
            group=_DRAWING,
        ),
        Range(above=0, at_most=4),
        OnlyWith("method", ("raster",)),
    ] = RESOLUTION
    maps: Annotated[
        Literal["tiff", "pfm"] | None,
        described(
            "Also write the warp map of each frame, and the view of the intermediate image (raster only).", group=_ALSO
        ),
        OnlyWith("method", ("raster",)),
    ] = None
    layers: Annotated[
        tuple[Layer, ...],
        described(
            "Also write EYE-NNNNNN.exr with these layers of what each pixel shows, one or more (docs/frames.md); "
            "instance: also instances.json, as COCO has it.",
            many=True,
            flag=True,
            group=_ALSO,
        ),
    ] = ()
    misalignment: Annotated[
        str | None,
        described(
            "Also compute how far each frame is misaligned to an eye that looks through the exact optics of this "
            "device: metadata.jsonl has the angles.",
            group=_ALSO,
        ),
    ] = None
    predicted_error: Annotated[
        float | None,
        described(
            "Also predict the registration error of points at this depth in metres: a small map for each frame, with "
            "the trackers' errors that `budget` assumes (docs/budget.md).",
            group=_ALSO,
        ),
        limits.DEPTH_M,
    ] = None
    per_colour: Annotated[
        bool,
        described(
            "Separate rays and warp maps for red, green and blue; a device is traced in all three.",
            flag=True,
            group=_COLOURS,
        ),
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
    video: Annotated[
        bool,
        described("Also write EYE.mp4 (VP9), and of both eyes stereo.mp4, side by side.", flag=True, group=_ALSO),
        NoEffect(),
    ] = False
    pack: Annotated[
        Layout | None,
        described(
            "Also pack the frames as a data set, into the folder OUT/webdataset or OUT/huggingface: tar files of "
            "WebDataset, or an image folder of Hugging Face's datasets.",
            group=_ALSO,
        ),
        NoEffect(),
    ] = None
    frames_per_shard: Annotated[
        int,
        described("Frames in each tar file (--pack webdataset only).", group=_ALSO),
        Range(1, 1_000_000),
        OnlyWith("pack", ("webdataset",)),
        NoEffect(),
    ] = 1000
    backend: Annotated[Backend, OnlyWith("method", ("raster",))] = "auto"
    workers: Annotated[
        int | None,
        described(
            "Number of processes that draw, each with one thread (default: this one, with a thread per core).",
            group=WORK,
        ),
        WORKERS,
        NoEffect(),
    ] = None
    scheduler: Scheduler = None
    out: Annotated[Path, described("Output folder; existing frames are kept."), NoEffect()] = Path("out/render")
    against: Against = None

    def __post_init__(self) -> None:
        """Check that several frames have a trajectory."""
        super().__post_init__()
        if self.frame_limit not in (None, 1) and self.head is None and self.eye_track is None:
            raise BadInputError(
                "--frames is used with --head or --eye-track only; leave it out (one frame of each eye is drawn), or "
                "give a trajectory."
            )

    @property
    def has_colours(self) -> bool:
        """True if red, green and blue have separate rays."""
        return self.per_colour or self.red_model is not None
