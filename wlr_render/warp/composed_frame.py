"""Composed frames, and the ray maps that they keep."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.gl.readback import Readback
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import checked_eye
from wlr_render.warp.ray_map import RayMapSolver, SolvedT

if TYPE_CHECKING:
    from wlr_render.warp.gl_backend import GlComposed


@dataclass(frozen=True, eq=False)
class ComposedFrame:
    """The panel images of one frame, which the next `compose` of the same eye overwrites.

    Attributes:
        eyes: by name.
        viewpoints: (3,) by eye that it was composed for, device frame, metres.
        world_from_device: (4, 4) head pose that it was composed for; of the first row, if rows have their own.
        check_readable: raises a `BadInputError` once an eye's picture is overwritten, or the compositor released.
    """

    eyes: "Mapping[str, GlComposed]"
    viewpoints: Mapping[str, FloatArray]
    world_from_device: FloatArray
    check_readable: Callable[[str], None]

    def read(self, eye: str | None = None) -> NDArray[Any]:
        """Fetch an eye's (height, width, 3), top row first; `eye` may be left out if there is one.

        uint8 sRGB, or as the compositor's `panel` says: its encoding, and uint8 for 8 bits, uint16 for 10 (65535 is the
        largest code), float16 for 16.

        Raises:
            BadInputError: no such eye, the picture was composed into your framebuffer, a later `compose` has
                overwritten it, or the compositor has been released.
        """
        return self._eye(eye).read_colour()

    def read_async(self, eye: str | None = None) -> Readback:
        """Start to fetch what `read` returns, and return at once; a later `compose` does not change the result.

        Raises:
            BadInputError: as `read`.
        """
        return self._eye(eye).read_async()

    def read_into(self, target: Any, eye: str | None = None) -> None:
        """Copy an eye's picture, RGBA with its top row first, into the caller's memory.

        Args:
            target: (height, width, 4) of the type that `read` returns, contiguous; or a ModernGL buffer of that size,
                to which the copy does not wait for the GPU.
            eye: may be left out if there is one.

        Raises:
            BadInputError: as `read`, or a target of another kind, size or context.
        """
        self._eye(eye).read_into(target)

    def status(self, eye: str | None = None) -> NDArray[np.uint8]:
        """Fetch what each pixel of an eye shows, (height, width) uint8, one `WarpStatus` each.

        Raises:
            BadInputError: as `read`.
        """
        return self._eye(eye).read_status()

    def texture(self, eye: str | None = None) -> Any:
        """Return an eye's ModernGL texture, RGBA with its top row first; nothing crosses to the CPU.

        Raises:
            BadInputError: the eye is unknown, or the picture was composed into a framebuffer.
        """
        texture = self._eye(eye).texture
        if texture is None:
            raise BadInputError("there is no texture: the picture is in the framebuffer that you gave; read it there.")
        return texture

    def source(self, eye: str | None = None, channel: int | None = None) -> NDArray[np.float32]:
        """Fetch an eye's pull map, (height, width, 2) positions in the submitted picture, NaN without one.

        Args:
            eye: may be left out if there is one.
            channel: 0, 1 or 2 for red, green or blue of an eye with three models; green if left out.

        Raises:
            BadInputError: as `read`, it was composed without, or red's or blue's is asked for after the eye's next
                `submit`.
        """
        source = self._eye(eye).read_source(channel)
        if source is None:
            raise BadInputError("there is no pull map; compose with_source, and not into a framebuffer of yours.")
        return source

    def unsolved(self) -> dict[str, dict[str, int]]:
        """Return the number of unsolved points of the ray maps, by eye and reason. Costs a small transfer."""
        for name in self.eyes:
            self.check_readable(name)
        return {name: eye.unsolved() for name, eye in self.eyes.items()}

    def _eye(self, eye: str | None) -> "GlComposed":
        if eye in ("left", "right") and eye not in self.eyes:
            raise BadInputError(
                f"the {eye} eye was not composed in this frame, which has {', '.join(self.eyes)}; if the headset has "
                "it, name it in the `eyes` of compose."
            )
        name = checked_eye(eye, tuple(self.eyes))
        self.check_readable(name)
        return self.eyes[name]


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
