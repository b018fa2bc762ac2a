"""Compositor backend without OpenGL, in numpy."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.compositing.backend import CachedRayMaps
from wlr_render.errors import BadInputError
from wlr_render.mappings import count_unsolved
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.cpu_ray_maps import CpuNodeSolver, CpuPixelSolver, RayMapSolver
from wlr_render.rendering.cpu_warp import warp_on_cpu
from wlr_render.rendering.raster_camera import EyePlan
from wlr_render.rendering.ray_map import RayMap, RayMapPlan, choose_plan
from wlr_render.rendering.stored_picture import Rows, StoredDepth, picture_of_arrays
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warp import WarpedImage
from wlr_render.rendering.warp_grid import WarpGrid


@dataclass(frozen=True, eq=False)
class _Composed:
    image: WarpedImage
    ray_maps: list[RayMap]
    texture: None = None

    def read(self) -> WarpedImage:
        return self.image

    def unsolved(self) -> dict[str, int]:
        return count_unsolved(each.status for each in self.ray_maps)

    def read_ray_maps(self) -> list[RayMap]:
        return self.ray_maps


class CpuEye:
    """One eye in numpy."""

    def __init__(self, plan: EyePlan, solve: str, background: tuple[int, int, int]) -> None:
        self._plan, self._background = plan, background
        pixels = WarpGrid.of_pixels(plan.channels[0].display.panel, plan.size_px)
        axes = plan.device_from_camera
        solves: list[RayMapSolver[RayMap]] = [
            CpuPixelSolver(mappings, pixels, axes)
            if solve == "pixels"
            else CpuNodeSolver(mappings, RayMapPlan.onto_grid(pixels, choose_plan(mappings).node_count, axes))
            for mappings in plan.channels
        ]
        self._ray_maps = CachedRayMaps(solves)
        self._picture: GeometryImage | None = None

    def set_picture(self, color: Any, depth: Any, stored: StoredDepth, rows: Rows | None) -> None:
        """See `EyeBackend`; arrays only."""
        if not (isinstance(color, np.ndarray) and isinstance(depth, np.ndarray)):
            raise BadInputError(
                f"a picture cannot be taken from a {type(color).__name__} and a {type(depth).__name__} without OpenGL; "
                "submit two arrays."
            )
        self._picture = picture_of_arrays(self._plan.camera, color, depth, stored, rows or Rows.TOP_FIRST)

    def compose(
        self, viewpoint: FloatArray, image_from_ray_map: FloatArray, target: Any, with_source: bool
    ) -> _Composed:
        """See `EyeBackend`."""
        assert self._picture is not None, "the compositor sees to it that every eye is submitted"
        plan = self._plan
        ray_maps = self._ray_maps.at(viewpoint)
        image = warp_on_cpu(
            self._picture,
            plan.camera,
            [each.slope_offset for each in ray_maps],
            image_from_ray_map,
            self._background,
            plan.samples_per_axis,
        )
        return _Composed(image, ray_maps)

    def forget(self) -> None:
        """See `EyeBackend`."""
        self._ray_maps.forget()


class CpuBackend:
    """All eyes in numpy."""

    name = "cpu"
    context = None

    def __init__(self, plans: Sequence[EyePlan], solve: str, background: tuple[int, int, int]) -> None:
        self.eyes = {plan.eye: CpuEye(plan, solve, background) for plan in plans}

    def working(self) -> AbstractContextManager[object]:
        """See `Backend`; there is no state to save."""
        return nullcontext()

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> Mapping[str, Any]:
        """See `Backend`: there are no framebuffers here.

        Raises:
            BadInputError: one is given.
        """
        if into is not None:
            raise BadInputError("there is no OpenGL here to draw into a framebuffer; read() what compose gives.")
        return {}

    def finish(self) -> None:
        """Does nothing: every call has finished."""

    def release(self) -> None:
        """Does nothing: all memory is Python's."""
