"""Regular grid of points on the panel at which rays are solved; between them they are interpolated bilinearly."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class WarpGrid:
    """Points in rows and columns over a panel, the top row first.

    Attributes:
        panel: of the pixel positions.
        columns, rows: how many points.
        first_px: (2,) panel position of the first point.
        step_px: (2,) from one point to the next.
    """

    panel: Panel
    columns: int
    rows: int
    first_px: FloatArray
    step_px: FloatArray

    @classmethod
    def of_pixels(cls, panel: Panel, size_px: tuple[int, int] | None = None) -> "WarpGrid":
        """The pixel centres of a picture (width, height) that covers the panel; the panel's own if None."""
        columns, rows = (panel.width_px, panel.height_px) if size_px is None else size_px
        step = panel.size_px / [columns, rows]
        return cls(panel, columns, rows, 0.5 * step, step)

    @classmethod
    def edge_to_edge(cls, panel: Panel, columns: int, rows: int) -> "WarpGrid":
        """Points from the panel's outer edges inwards, so that every pixel lies between some."""
        return cls(panel, columns, rows, np.zeros(2), panel.size_px / [columns - 1, rows - 1])

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows), as a texture's size."""
        return self.columns, self.rows

    def axes_px(self) -> tuple[FloatArray, FloatArray]:
        """Panel positions u (columns,) and v (rows,) of the points."""
        u, v = (
            first + step * np.arange(count)
            for first, step, count in zip(self.first_px, self.step_px, self.size, strict=True)
        )
        return u, v

    def panel_pixel(self) -> FloatArray:
        """Panel positions of all points, (rows, columns, 2)."""
        return np.stack(np.meshgrid(*self.axes_px()), axis=-1)

    def has_pixel_centres_of(self, size_px: tuple[int, int]) -> bool:
        """Whether the points are the pixel centres of a picture (width, height)."""
        return self.size == tuple(size_px) and np.allclose(self.first_px, 0.5 * self.step_px)

    def texture_from_picture(self, size_px: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """(scale, offset), (2,) each: where a pixel of a picture (width, height) is read, in normalised coordinates.

        `scale * pixel + offset` of a pixel position that counts from the picture's outer top left corner.
        """
        panel_px_per_pixel = self.panel.size_px / size_px
        scale = panel_px_per_pixel / self.step_px / self.size
        return np.asarray(scale), np.asarray((0.5 - self.first_px / self.step_px) / self.size)
