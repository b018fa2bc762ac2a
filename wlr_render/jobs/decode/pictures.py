"""Pictures of a decoded set of photographs: positions, rejections, and what flat surfaces leave."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded, Rejection
from wlr_render.evaluation.code_quality import PlaneSurvey
from wlr_render.files import write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACCEPTED, _DARK = "#e4ebdd", "#202020"
_BLOCK_PX = 4  # camera pixels that one point of the residual picture averages
_RANGE_PX = 0.75  # panel pixels at the ends of its colour scale


def draw_positions(path: Path, decoded: Decoded) -> Path:
    """Decoded u and v, side by side."""
    figure, places = _side_by_side(decoded.rejection.shape)
    for axis, (place, name) in enumerate(zip(places, "uv", strict=True)):
        drawn = place.imshow(decoded.pixel[..., axis], cmap="turbo", interpolation="nearest")
        figure.colorbar(drawn, ax=place, label=f"{name} (panel px)", shrink=0.8)
    return write_figure(path, figure, 100)


def draw_rejections(path: Path, decoded: Decoded) -> Path:
    """The fate of each camera pixel."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = fate_colours()
    height, width = decoded.rejection.shape
    figure = Figure(figsize=(9, 9 * height / width + 1.6), layout="constrained")
    place = figure.add_subplot()
    place.imshow(colours[decoded.rejection], interpolation="nearest")
    place.set(xticks=[], yticks=[])
    shares = ((reason, count / decoded.rejection.size) for reason, count in decoded.counts().items())
    marks = [Patch(color=colours[reason], label=f"{share:.1%} {reason.sentence}") for reason, share in shares]
    figure.legend(handles=marks, loc="outside lower center", ncols=1, fontsize=8)
    return write_figure(path, figure, 100)


def fate_colours() -> NDArray[np.float64]:
    """Red, green and blue of each `Rejection`, (number of reasons, 3)."""
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb

    faults = [colormaps["tab10"](number)[:3] for number in range(len(Rejection) - 2)]
    return np.array([to_rgb(_ACCEPTED), to_rgb(_DARK), *faults])


def draw_residuals(path: Path, survey: PlaneSurvey, heading: str) -> Path:
    """Decoded minus predicted by the surfaces' homographies, in u and v, averaged over small blocks."""
    figure, places = _side_by_side(survey.label.shape)
    means = _block_means(survey.residual)
    for axis, (place, name) in enumerate(zip(places, "uv", strict=True)):
        drawn = place.imshow(means[..., axis], cmap="RdBu", vmin=-_RANGE_PX, vmax=_RANGE_PX, interpolation="nearest")
        place.set_title(f"{name}: decoded - predicted, mean of {_BLOCK_PX} x {_BLOCK_PX} camera pixels", fontsize=9)
        place.set_facecolor("0.75")
    figure.colorbar(drawn, ax=places, label="panel px", extend="both", shrink=0.8)
    figure.suptitle(f"What homographies of flat surfaces leave ({heading})")
    return write_figure(path, figure, 100)


def _side_by_side(shape: tuple[int, ...]) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 6.5 * shape[0] / shape[1] + 0.8), layout="constrained")
    places = list(figure.subplots(1, 2))
    for place in places:
        place.set(xticks=[], yticks=[])
    return figure, places


def _block_means(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means (h / block, w / block, 2) of what is not NaN; a rest at the right and the bottom is left out."""
    rows, columns = (size // _BLOCK_PX for size in values.shape[:2])
    blocks = values[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns, _BLOCK_PX, 2)
    valid = np.isfinite(blocks)
    count = valid.sum(axis=(1, 3))
    sums = np.where(valid, blocks, 0.0).sum(axis=(1, 3))
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan).astype(np.float32)
