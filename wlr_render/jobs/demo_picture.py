"""Picture of the demo: the eye's view with each drawing method, with a close-up."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.evaluation.metrics import Summary
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.atomic_files import write_figure
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import cell_text

OVERVIEW_WIDTH_PX = 720
CLOSE_UP_WIDTH_PX = 480
CLOSE_UP_SHARE = 0.16
"""Width of the close-up as a share of the overview's."""

_COLUMN_INCH = 3.6
_NOTE = (
    "Real object and display are both seen through the device's exact optics, from a pupil position off the centre of "
    "the eye box.\nMisalignment over the whole display at this position, in arcminutes (1' is 0.3 mm at 1 m). "
    "Predicted: from the calibration alone."
)


@dataclass(frozen=True, eq=False)
class Panorama:
    """View of the eye in one state of the display: overview, close-up and caption."""

    title: str
    overview: NDArray[np.uint8]
    close_up: NDArray[np.uint8]
    caption: str


def misalignment_caption(s: Summary, prediction: tuple[float, float] | None = None) -> str:
    """Return the caption of a panorama; `prediction` is the predicted and the true rms."""
    median, p95, maximum = (cell_text(x) for x in (s.median, s.p95, s.maximum))
    lines = [f"off by {median}' median", f"{p95}' at 95 %, {maximum}' at most"]
    if prediction is not None:
        predicted, true = (cell_text(x) for x in prediction)
        lines.append(f"predicted {predicted}' rms, true {true}' rms")
    return "\n".join(lines)


def overview_camera(tangents: FloatArray) -> Pinhole:
    """Return an eyeball camera whose picture contains all `tangents` (n, 2)."""
    width = float(np.ptp(tangents[:, 0]))
    return Pinhole.covering(tangents, OVERVIEW_WIDTH_PX / width)


def close_up_camera(overview: Pinhole, centre: FloatArray) -> Pinhole:
    """Return a camera of a square window of the overview around `centre` (2,) tangents, enlarged."""
    half = 0.5 * CLOSE_UP_SHARE * (overview.tangent_max - overview.tangent_min)[0]
    centre = np.clip(centre, overview.tangent_min + half, overview.tangent_max - half)
    return Pinhole(CLOSE_UP_WIDTH_PX, CLOSE_UP_WIDTH_PX, centre - half, centre + half)


def busiest_place(camera: Pinhole, picture: NDArray[np.uint8]) -> FloatArray:
    """Return the tangents (2,) of the close-up window with the most edges, where misalignment is most visible."""
    import cv2

    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    edges = np.abs(cv2.Laplacian(grey, cv2.CV_32F))
    side = max(3, int(CLOSE_UP_SHARE * camera.width_px))
    density = cv2.blur(edges, (side, side), borderType=cv2.BORDER_CONSTANT)
    row, column = np.unravel_index(int(np.argmax(density)), density.shape)
    return camera.tangents_of_pixel(np.array([column + 0.5, row + 0.5]))


def save_picture(path: Path, panoramas: Sequence[Panorama], window: tuple[Pinhole, Pinhole], heading: str) -> Path:
    """Draw the panoramas side by side, close-ups below, captions under them; `window` is overview and close-up."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    height, width = panoramas[0].overview.shape[:2]
    rows = [_COLUMN_INCH * height / width, _COLUMN_INCH]
    size = (_COLUMN_INCH * len(panoramas) + 0.3, sum(rows) + 2.2)
    figure = Figure(figsize=size, dpi=130, facecolor="white")
    grid = figure.add_gridspec(
        2, len(panoramas), height_ratios=rows, wspace=0.03, hspace=0.02,
        left=0.01, right=0.99, bottom=1.27 / size[1], top=1 - 0.93 / size[1],
    )  # fmt: skip
    corner, extent = _window_px(*window)
    for column, panorama in enumerate(panoramas):
        above, below = (figure.add_subplot(grid[row, column]) for row in (0, 1))
        above.imshow(panorama.overview, interpolation="none")
        above.add_patch(Rectangle(corner, *extent, fill=False, edgecolor="yellow", linewidth=1.2))
        above.set_title(panorama.title, fontsize=14, fontweight="bold")
        below.imshow(panorama.close_up, interpolation="none")
        below.set_xlabel(panorama.caption, fontsize=12)
        for axes, colour in ((above, "black"), (below, "gold")):
            axes.set(xticks=[], yticks=[])
            for spine in axes.spines.values():
                spine.set_color(colour)
    figure.suptitle(heading, fontsize=17, y=1 - 0.12 / size[1], va="top")
    figure.text(0.5, 0.12 / size[1], _NOTE, ha="center", fontsize=11, color="0.3")
    return write_figure(path, figure)


def _window_px(overview: Pinhole, close_up: Pinhole) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the corner and the size of the close-up in the overview, with matplotlib's integer pixel centres."""
    left, bottom = overview.pixel_of_tangents(close_up.tangent_min) - 0.5
    right, top = overview.pixel_of_tangents(close_up.tangent_max) - 0.5
    return (float(left), float(top)), (float(right - left), float(bottom - top))
