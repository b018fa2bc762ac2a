"""Run a compositor on a workload, frame after frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

import numpy as np

from benchmarks.scene_source import SceneSource
from benchmarks.speed.timing import GpuRun, Run
from benchmarks.speed.workload import HEAD_POSE, Workload
from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.frame_handle import FrameHandle

LATE_S = 0.010
"""Time from drawing to scan-out, and scan-out time from the first to the last row."""
TURN_DEG_PER_S, WALK_M_PER_S, PUPIL_M_PER_S = 100.0, 0.5, 0.05
"""Speeds of a brisk head turn, of a step, and of a pupil 10.5 mm from the centre of an eye turning at 270 deg/s."""


def later_pose(pose: FloatArray, seconds: float = LATE_S) -> FloatArray:
    """Return a head pose (4, 4) some time later: the head turns about its vertical axis and moves right and ahead."""
    turned = transforms.rotation_about("y", np.deg2rad(TURN_DEG_PER_S) * seconds)
    step = WALK_M_PER_S * seconds * np.array([0.6, 0.0, -0.8])
    return np.asarray(pose @ transforms.rigid(turned, step))


@dataclass(frozen=True, eq=False)
class Running:
    """A compositor for the workload's eyes, fed by our own rasteriser; a context manager."""

    work: Workload
    compositor: Compositor
    source: SceneSource

    @classmethod
    def of(
        cls,
        work: Workload,
        context: Any = "auto",
        size: tuple[int, int] | None = None,
        channels: int = 1,
    ) -> "Running":
        """Create the compositor and the rasteriser.

        Args:
            work: workload with the eyes to compose.
            context: see `Compositor`.
            size: (width, height) of the display; the panel's if None.
            channels: 3 for a separate ray field for each colour, all from the same mappings.

        Raises:
            BadInputError, MissingGlError: see `Compositor`.
        """
        panel = work.mappings.display.panel
        models = {eye: (mappings,) * channels for eye, mappings in work.eyes.items()}
        compositor = Compositor(models, size or (panel.width_px, panel.height_px), context=context)
        return cls(work, compositor, SceneSource(compositor, work.scene))

    def __enter__(self) -> "Running":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.compositor.release()

    @property
    def gl_context(self) -> gl.GlContext:
        """The compositor's OpenGL context."""
        context = self.compositor.context
        assert isinstance(context, gl.GlContext), "the caller has seen to it that there is OpenGL"
        return context

    def begin(self, turn: int) -> FrameHandle:
        """Begin the frame of a round."""
        return self.compositor.begin_frame(HEAD_POSE, self.work.viewpoint_of_eyes(turn))

    def frame(self, turn: int) -> ComposedFrame:
        """Draw the whole frame of a round; a second frame in the same round does not solve the field again."""
        for camera in self.begin(turn).values():
            self.source.submit(camera)
        return self.compositor.compose()

    def warp_of_a_new_picture(self) -> GpuRun:
        """Return a run that submits round 0's picture as new, with depths not yet known, and composes it."""
        size = self.compositor.size_px[0] * len(self.work.eyes), self.compositor.size_px[1]
        with self.gl_context.drawing():
            target = self.gl_context.framebuffer([self.gl_context.target(size, 4, "f1")])
        images = {eye: self.source.submit(camera) for eye, camera in self.begin(0).items()}

        def run(_: int) -> None:
            self.begin(0)
            for eye, image in images.items():
                self.compositor.submit(replace(image), eye=eye)
            self.compositor.compose(target)

        return self.of_round(run)

    def of_round(self, job: Run) -> GpuRun:
        """Return a run that calls a job with the number of the round."""
        return GpuRun(job, self.gl_context.drawing)

    def same(self, job: Callable[[], object]) -> GpuRun:
        """Return a run that calls a job that is the same in all rounds."""
        return self.of_round(lambda _: job())
