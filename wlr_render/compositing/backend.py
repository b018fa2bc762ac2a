"""Backends of a compositor (an own OpenGL context, an adopted one, or the CPU), and the frames that they compose."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Generic, Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.compositing.checks import checked_eye
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.mappings import require_planar
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.cpu_ray_maps import RayMapSolver, SolvedT
from wlr_render.rendering.raster_camera import EyePlan
from wlr_render.rendering.ray_map import RayMap
from wlr_render.rendering.stored_picture import Rows, StoredDepth
from wlr_render.rendering.warp import WarpedImage


class ComposedEye(Protocol):
    """One eye's picture."""

    @property
    def texture(self) -> Any:
        """The ModernGL texture, RGBA8 with its top row first; None without OpenGL."""

    def read(self) -> WarpedImage:
        """Fetch colour and status."""

    def unsolved(self) -> dict[str, int]:
        """Number of unsolved points of the ray maps by reason; empty if all are solved."""

    def read_ray_maps(self) -> list[RayMap]:
        """Fetch the ray maps of the picture at the points of the warp grid, one per channel."""


@dataclass(frozen=True, eq=False)
class ComposedFrame:
    """The panel images of one frame, which the compositor's next `compose` overwrites.

    Attributes:
        eyes: by name.
        check_alive: raises a `BadInputError` once the compositor has been released.
    """

    eyes: Mapping[str, ComposedEye]
    check_alive: Callable[[], None]

    def read(self, eye: str | None = None) -> NDArray[np.uint8]:
        """Fetch an eye's (height, width, 3) uint8 sRGB, top row first; `eye` may be left out if there is one.

        Raises:
            BadInputError: no such eye, the picture was composed into your framebuffer, or the compositor has been
                released.
        """
        return self._eye(eye).read().colour

    def texture(self, eye: str | None = None) -> Any:
        """An eye's ModernGL texture, RGBA8 with its top row first; nothing crosses to the CPU.

        Raises:
            BadInputError: no such eye, or there is no texture.
        """
        texture = self._eye(eye).texture
        if texture is None:
            raise BadInputError("there is no texture: the picture is in numpy, or in the framebuffer that you gave.")
        return texture

    def source(self, eye: str | None = None) -> NDArray[np.float32]:
        """Fetch an eye's pull map, (height, width, 2) positions in the submitted picture, NaN where there is none.

        Raises:
            BadInputError: no such eye, or it was composed without.
        """
        source = self._eye(eye).read().source
        if source is None:
            raise BadInputError("there is no pull map; compose with_source, and not into a framebuffer of yours.")
        return source

    def unsolved(self) -> dict[str, dict[str, int]]:
        """Number of unsolved points of the ray maps, by eye and reason. Costs a small transfer."""
        self.check_alive()
        return {name: eye.unsolved() for name, eye in self.eyes.items()}

    def _eye(self, eye: str | None) -> ComposedEye:
        self.check_alive()
        return self.eyes[checked_eye(eye, tuple(self.eyes))]


class CachedRayMaps(Generic[SolvedT]):
    """The ray maps of an eye's channels, solved again only when the viewpoint has changed."""

    def __init__(self, solves: Sequence[RayMapSolver[SolvedT]]) -> None:
        self._solves = solves
        self._solved: tuple[FloatArray, list[SolvedT]] | None = None

    def at(self, viewpoint: FloatArray) -> list[SolvedT]:
        """One ray map per channel at a viewpoint (3,), which is kept for comparison: do not write into it."""
        if self._solved is None or (self._solved[0] != viewpoint).any():
            self._solved = None  # a solve that fails leaves ray maps of two viewpoints
            self._solved = viewpoint, [solve.solve(viewpoint) for solve in self._solves]
        return self._solved[1]

    def forget(self) -> None:
        """Solve the next ray maps cold."""
        self._solved = None
        for solve in self._solves:
            solve.forget()


CONTEXTS = ("auto", "egl", "osmesa", "cpu", "current")
SOLVES = ("auto", "pixels", "nodes")


class EyeBackend(Protocol):
    """One eye: imports the rendered picture, composes the panel image."""

    def set_picture(self, color: Any, depth: Any, stored: StoredDepth, rows: Rows | None) -> None:
        """See `Compositor.submit`; on an error the last picture stays."""

    def compose(
        self, viewpoint: FloatArray, image_from_ray_map: FloatArray, target: Any, with_source: bool
    ) -> ComposedEye:
        """The picture for a viewpoint (3,), through (4, 4) or (rows, 4, 4), into a target of `Backend.targets`."""

    def forget(self) -> None:
        """Solve the next frame cold."""


class Backend(Protocol):
    """All eyes of a headset."""

    @property
    def name(self) -> str:
        """Name of the renderer."""

    @property
    def context(self) -> Any:
        """See `Compositor.context`."""

    @property
    def eyes(self) -> Mapping[str, EyeBackend]:
        """By name."""

    def working(self) -> AbstractContextManager[object]:
        """Return a block of calls, around which the caller's OpenGL state is saved and restored once."""

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> Mapping[str, Any]:
        """Target of each eye's picture; empty for own textures or arrays. See `Compositor.compose`."""

    def finish(self) -> None:
        """Block until the GPU is idle."""

    def release(self) -> None:
        """Free everything."""


def open_backend(context: Any, plans: Sequence[EyePlan], solve: str, background: tuple[int, int, int]) -> Backend:
    """The backend that `Compositor(context=..., solve=...)` names.

    Raises:
        BadInputError: an unknown name, pixels for models that are not planar, or sizes that are too large.
        MissingGlError: OpenGL was asked for by name and does not open, or a context is too old.
    """
    if isinstance(context, str) and context not in CONTEXTS:
        raise BadInputError(f"context '{context}': choose from {', '.join(CONTEXTS)}, or give a moderngl.Context.")
    if solve not in SOLVES:
        raise BadInputError(f"solve '{solve}': choose from {', '.join(SOLVES)}.")
    if solve == "pixels":
        for mappings in (each for plan in plans for each in plan.channels):
            require_planar(mappings)
    if context != "cpu":
        from wlr_render.compositing.gl_backend import GlBackend

        try:
            return GlBackend(context, plans, solve, background)
        except MissingGlError:
            if context != "auto":
                raise
    from wlr_render.compositing.cpu_backend import CpuBackend

    return CpuBackend(plans, solve, background)
