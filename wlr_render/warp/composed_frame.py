"""Composed frames, and the ray maps that they keep."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.readback import Readback, ReadbackRing, read_into, read_rgb
from wlr_render.io.input_files import shown
from wlr_render.mappings import count_unsolved
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import checked_eye
from wlr_render.warp.gl_ray_maps import GpuRayMap
from wlr_render.warp.gl_warp import GpuWarped
from wlr_render.warp.ray_map import RayMap, RayMapSolver, SolvedT


@dataclass(frozen=True, eq=False)
class GlComposed:
    """One eye's picture on the GPU; `warped` is None if it was drawn into the caller's framebuffer.

    `draw_source` draws the pull map of a channel other than green, from the submitted picture; None if the picture was
    composed without pull maps.
    """

    warped: GpuWarped | None
    ray_maps: list[GpuRayMap]
    readbacks: ReadbackRing
    draw_source: Callable[[int], GpuWarped] | None = None

    @property
    def texture(self) -> gl.Texture | None:
        """The texture with its top row first; None if the picture was drawn into the caller's framebuffer."""
        return self.warped.colour if self.warped else None

    def read_async(self) -> Readback:
        """Start fetching the colour."""
        return self.readbacks.start(self._own().colour)

    def read_into(self, target: Any) -> None:
        """Copy the colour as RGBA into an array, or into a buffer on the GPU."""
        own = self._own()
        with own.context.drawing():
            read_into(own.context, own.colour, target)

    def read_colour(self) -> NDArray[Any]:
        """Fetch the colour without alpha, (height, width, 3)."""
        own = self._own()
        with own.context.drawing():
            return read_rgb(own.colour)

    def read_status(self) -> NDArray[np.uint8]:
        """Fetch the status (height, width) uint8, one `WarpStatus` each."""
        own = self._own()
        with own.context.drawing():
            return gl.read(own.status, np.uint8)

    def read_source(self, channel: int | None) -> NDArray[np.float32] | None:
        """Fetch the pull map of a channel, green's if None; return None if the picture was composed without one."""
        own = self._own()
        chosen = len(self.ray_maps) // 2 if channel is None else channel
        if chosen not in range(len(self.ray_maps)):
            raise BadInputError(f"channel {shown(channel)} does not exist; the eye has {len(self.ray_maps)}.")
        is_there = own.source is None or chosen == len(self.ray_maps) // 2  # the map of a three-channel warp is green's
        drawn = own if is_there or self.draw_source is None else self.draw_source(chosen)
        if drawn.source is None:
            return None
        with drawn.context.drawing():
            return gl.read(drawn.source, np.float32)

    def unsolved(self) -> dict[str, int]:
        """Return the number of unsolved points of the ray maps by reason; empty if all are solved."""
        return count_unsolved(each.read_status() for each in self.ray_maps)

    def read_ray_maps(self) -> list[RayMap]:
        """Fetch the ray maps at the points of the warp grid, one per channel."""
        return [each.read() for each in self.ray_maps]

    def _own(self) -> GpuWarped:
        if self.warped is None:
            raise BadInputError("the picture was composed into your framebuffer; read that, or compose without `into`.")
        return self.warped


@dataclass(frozen=True, eq=False)
class ComposedFrame:
    """The panel images of one frame, which the next `compose` of the same eye overwrites.

    Attributes:
        eyes: pictures by eye.
        viewpoints: (3,) viewpoints of the frame by eye, device frame, metres.
        world_from_device: (4, 4) head pose of the frame; of its first row if rows have separate poses.
        reading: block in which an eye's picture is read, while no other thread composes; raises `BadInputError` once
            the picture is overwritten or the compositor released.
    """

    eyes: Mapping[str, GlComposed]
    viewpoints: Mapping[str, FloatArray]
    world_from_device: FloatArray
    reading: Callable[[str], AbstractContextManager[object]]

    def read(self, eye: str | None = None) -> NDArray[Any]:
        """Fetch an eye's picture (height, width, 3), top row first; `eye` may be omitted if there is one.

        uint8 sRGB, or the encoding of the compositor's `panel`, in uint8 for 8 bits, uint16 for 10 (65535 is the
        largest code), float16 for 16.

        Raises:
            BadInputError: no such eye, the picture was composed into your framebuffer, a later `compose` has
                overwritten it, or the compositor has been released.
        """
        with self._eye(eye) as own:
            return own.read_colour()

    def read_async(self, eye: str | None = None) -> Readback:
        """Start fetching the result of `read`, and return at once; a later `compose` does not change it.

        Three pictures of an eye may be in flight: while the last three are unread, this waits for the first.

        Raises:
            BadInputError: see `read`.
        """
        with self._eye(eye) as own:
            return own.read_async()

    def read_into(self, target: Any, eye: str | None = None) -> None:
        """Copy an eye's picture, RGBA with its top row first, into the caller's memory.

        Args:
            target: (height, width, 4) of the type that `read` returns, contiguous; or a ModernGL buffer of that size,
                to which the copy does not wait for the GPU.
            eye: may be omitted if there is one.

        Raises:
            BadInputError: a target of another kind, size or context; see also `read`.
        """
        with self._eye(eye) as own:
            own.read_into(target)

    def status(self, eye: str | None = None) -> NDArray[np.uint8]:
        """Fetch the status of an eye's pixels, (height, width) uint8, one `WarpStatus` each.

        Raises:
            BadInputError: see `read`.
        """
        with self._eye(eye) as own:
            return own.read_status()

    def texture(self, eye: str | None = None) -> Any:
        """Return an eye's ModernGL texture, RGBA with its top row first; nothing crosses to the CPU.

        Raises:
            BadInputError: the eye is unknown, or the picture was composed into a framebuffer.
        """
        with self._eye(eye) as own:
            texture = own.texture
        if texture is None:
            raise BadInputError("there is no texture: the picture is in the framebuffer that you gave; read it there.")
        return texture

    def source(self, eye: str | None = None, channel: int | None = None) -> NDArray[np.float32]:
        """Fetch an eye's pull map, (height, width, 2) positions in the submitted picture, NaN without one.

        Args:
            eye: may be omitted if there is one.
            channel: 0, 1 or 2 for red, green or blue of an eye with three models; green by default.

        Raises:
            BadInputError: the frame was composed without pull maps, or red's or blue's is requested after the eye's
                next `submit`; see also `read`.
        """
        with self._eye(eye) as own:
            source = own.read_source(channel)
        if source is None:
            raise BadInputError("there is no pull map; compose with_source, and not into a framebuffer of yours.")
        return source

    def unsolved(self) -> dict[str, dict[str, int]]:
        """Return the number of unsolved points of the ray maps, by eye and reason. Costs a small transfer."""
        found = {}
        for name in self.eyes:
            with self._eye(name) as own:
                found[name] = own.unsolved()
        return found

    @contextlib.contextmanager
    def _eye(self, eye: str | None) -> Iterator[GlComposed]:
        if eye in ("left", "right") and eye not in self.eyes:
            raise BadInputError(
                f"the {eye} eye was not composed in this frame, which has {', '.join(self.eyes)}; if the headset has "
                "it, name it in the `eyes` of compose."
            )
        name = checked_eye(eye, tuple(self.eyes))
        with self.reading(name):
            yield self.eyes[name]


class CachedRayMaps(Generic[SolvedT]):
    """The ray maps of an eye's channels, solved again only when the viewpoint has changed."""

    def __init__(self, solves: Sequence[RayMapSolver[SolvedT]]) -> None:
        self._solves = solves
        self.forget()

    def forget(self) -> None:
        """Solve again at the next viewpoint, even at the same one."""
        self._solved: tuple[FloatArray, list[SolvedT]] | None = None

    def at(self, viewpoint: FloatArray) -> list[SolvedT]:
        """Return one ray map per channel at a viewpoint (3,), which is kept for comparison: do not modify it."""
        if self._solved is None or (self._solved[0] != viewpoint).any():
            self._solved = None  # a failed solve would leave ray maps of two viewpoints
            self._solved = viewpoint, [solve.solve(viewpoint) for solve in self._solves]
        return self._solved[1]
