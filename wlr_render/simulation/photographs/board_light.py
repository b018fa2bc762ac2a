"""Radiance of a dot board in front of a far background."""

from dataclasses import dataclass

import numpy as np

from wlr_render.captures.boards.board import Board
from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.simulation.photographs.printed_board import PrintedBoard

_BOW_STEPS = 3  # iterations for the intersection with a bowed board; each reduces the error a hundredfold


@dataclass(frozen=True)
class FarWall:
    """A background at infinity of smooth light and dark patches, which depend only on direction.

    Attributes:
        brightness: mean brightness.
        contrast: amplitude of the patches, relative to the mean.
        patch_rad: approximate distance of neighbouring light patches, radians.
    """

    brightness: float = 0.1
    contrast: float = 0.3
    patch_rad: float = 0.15

    def __call__(self, ray: Float32Array) -> Float32Array:
        """Return the brightness of the background along rays."""
        x, y, z = np.moveaxis(ray[..., 3:] * np.float32(2.0 * np.pi / self.patch_rad), -1, 0)
        patches = (np.sin(x + 0.7 * z) + np.sin(y + 1.3 * z) + np.sin(0.61 * (x + y))) / 3.0
        return np.asarray(self.brightness * (1.0 + self.contrast * patches))


@dataclass(frozen=True, eq=False)
class BoardLight:
    """Radiance of a dot board in front of a background, for `CameraView.world_light`.

    Attributes:
        board: the board, flat and exact, or as printed.
        frame_from_target: (4, 4) pose of the board in the frame of the view; only its front is visible.
        wall: the background.
        white: brightness of the white areas.
        black: brightness of the dots.
        softness: width of the dots' soft edges, in pixel footprints; 1 / sqrt(n) for n rays per pixel.
    """

    board: Board | PrintedBoard
    frame_from_target: FloatArray
    wall: FarWall = FarWall()
    white: float = 0.8
    black: float = 0.05
    softness: float = 0.25

    def __call__(self, ray: Float32Array) -> Float32Array:
        """Return the brightness of the board or the background along rays."""
        place = self._place(ray)
        reflectance = self.board.reflectance(place, self.softness * _footprint(place))
        light = np.asarray(self.black + (self.white - self.black) * reflectance, dtype=np.float32)
        missed = np.isnan(light)
        light[missed] = self.wall(ray[missed])
        return light

    def _place(self, ray: Float32Array) -> Float32Array:
        """Return the positions (h, w, 2) on the board where rays (h, w, 6) meet its front; NaN elsewhere."""
        target_from_frame = inverse(self.frame_from_target).astype(np.float32)
        rotation, shift = target_from_frame[:3, :3], target_from_frame[:3, 3]
        origin, direction = ray[..., :3] @ rotation.T + shift, ray[..., 3:] @ rotation.T
        place = _on_plane(origin, direction, origin[..., 2])
        if isinstance(self.board, PrintedBoard) and not self.board.is_flat:
            for _ in range(_BOW_STEPS):
                place = _on_plane(origin, direction, origin[..., 2] - self.board.height(place).astype(np.float32))
        return place


def _on_plane(origin: Float32Array, direction: Float32Array, depth: Float32Array) -> Float32Array:
    """Return x and y (h, w, 2) where rays reach a plane at `depth` (h, w) below their origins; NaN from behind."""
    with np.errstate(divide="ignore", invalid="ignore"):
        along = -depth / direction[..., 2]
    along[~((along > 0.0) & (direction[..., 2] > 0.0))] = np.nan
    # Axis by axis, because numpy is slow over a last axis of two.
    return np.stack([origin[..., axis] + along * direction[..., axis] for axis in range(2)], axis=-1)


def _footprint(place: Float32Array) -> Float32Array:
    """Return the width (h, w) of a camera pixel on the board, metres: root of its area, from positions (h, w, 2)."""
    (x_down, x_right), (y_down, y_right) = np.gradient(place[..., 0]), np.gradient(place[..., 1])
    return np.asarray(np.sqrt(np.abs(x_right * y_down - y_right * x_down)))
