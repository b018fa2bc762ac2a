"""Composed panel images, kept where they were made until they are read."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.rendering.ray_map import RayMap
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
    """

    eyes: Mapping[str, ComposedEye]

    def read(self, eye: str | None = None) -> NDArray[np.uint8]:
        """Fetch an eye's (height, width, 3) uint8 sRGB, top row first; `eye` may be left out if there is one.

        Raises:
            BadInputError: no such eye, or the picture was composed into your framebuffer.
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
        return {name: eye.unsolved() for name, eye in self.eyes.items()}

    def _eye(self, eye: str | None) -> ComposedEye:
        if eye is None and len(self.eyes) == 1:
            (only,) = self.eyes.values()
            return only
        if eye is None or eye not in self.eyes:
            raise BadInputError(f"there is no eye '{eye}' in this frame; name one of {', '.join(self.eyes)}.")
        return self.eyes[eye]
