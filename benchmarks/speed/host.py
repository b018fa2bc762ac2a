"""What a compositor costs its host program: CPU time and OpenGL calls of a frame, GPU memory of an eye."""

from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np

from benchmarks.speed.figures import Figure, Part
from benchmarks.speed.timing import in_ms, ratio
from benchmarks.speed.workload import HEAD_POSE, Workload
from benchmarks.submission.measure import WAYS, measure
from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl import gl
from wlr_render.warp.compositor import Compositor

SUBMISSION_GOAL_MS, CALLS_GOAL, MEMORY_GOAL_MB = 0.6, 30, 8.0
FRAMES, _TURNS = 60, 5
"""Number of timed frames in each turn, and number of turns for each of the two ways."""
_BYTES = {"f1": 1, "u1": 1, "f2": 2, "f4": 4, "i4": 4, "u4": 4}
_TIME, _CALLS = "CPU time to submit a frame of both eyes, drawing stubbed out", "OpenGL calls / gets of that frame"


def submission(work: Workload, frames: int = FRAMES) -> Part:
    """Time a frame with a host's context present, and one without a host; see `bench submission`."""
    panel = work.mappings.display.panel
    size, ways = (panel.width_px, panel.height_px), ("own", "shared")
    try:
        found = [[measure(work.eyes, size, way, frames) for way in ways] for _ in range(_TURNS)]
    except (BadInputError, MissingGlError) as error:
        return Part([Figure(_TIME, f"not measured: {error}")])
    own, shared = found[0]
    own_ms, shared_ms = np.array([[each.frame_ms for each in turn] for turn in found]).T
    middle_ms = float(np.median(shared_ms))
    return Part(
        [
            Figure(
                f"{_TIME}, {WAYS['shared']}",
                in_ms(middle_ms),
                f"{in_ms(np.median(own_ms))} ({WAYS['own']})",
                str(ratio(shared_ms, own_ms)),
                f"<= {in_ms(SUBMISSION_GOAL_MS)}",
                middle_ms <= SUBMISSION_GOAL_MS,
            ),
            Figure(
                _CALLS,
                f"{shared.calls} / {shared.gets}",
                f"{own.calls} / {own.gets} ({WAYS['own']})",
                f"{shared.calls / own.calls:.2f}",
                f"<= {CALLS_GOAL} / 0",
                shared.calls <= CALLS_GOAL and shared.gets == 0,
            ),
        ]
    )


def memory(work: Workload, context: str) -> Part:
    """Measure the GPU memory of one eye, without the picture (which is not copied) and the host's target."""
    found_mb = eye_bytes(work, context) / 1e6
    text = f"{found_mb:.1f} MB"
    goal = f"<= {MEMORY_GOAL_MB:g} MB"
    return Part(
        [
            Figure(
                "GPU memory of an eye, without the picture and the target",
                text,
                "",
                "",
                goal,
                found_mb <= MEMORY_GOAL_MB,
            )
        ]
    )


def eye_bytes(work: Workload, context: str) -> int:
    """Return the bytes of textures and buffers that a compositor makes to draw one eye into a host's framebuffer."""
    panel = work.mappings.display.panel
    size = panel.width_px, panel.height_px
    with gl.open_context(context) as opened:
        raster = GlRaster(opened, work.scene)
        with opened.drawing():
            target = opened.framebuffer([opened.target(size, 4, "f1")])
        made: set[Any] = set()

        def noting(job: Callable[[], Any]) -> Any:
            before = set(vars(opened)["_objects"])
            result = job()
            made.update(set(vars(opened)["_objects"]) - before)
            return result

        compositor = noting(lambda: Compositor(work.mappings, size, context=opened))
        (camera,) = compositor.begin_frame(HEAD_POSE, work.viewpoints[0]).values()
        picture = raster.draw_on_gpu(camera.view)
        noting(lambda: compositor.submit(picture))
        noting(lambda: compositor.compose(target))
        return sum(map(_bytes, made))


def _bytes(thing: Any) -> int:
    if isinstance(thing, moderngl.Buffer):
        return int(thing.size)
    if not isinstance(thing, moderngl.Texture):
        return 0
    texel = 4 if thing.depth else thing.components * _BYTES[thing.dtype]
    return int(thing.width * thing.height * texel)
