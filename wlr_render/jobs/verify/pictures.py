"""The on-device experiment in pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photographs import Photograph, read_photograph
from wlr_render.files import write_figure
from wlr_render.jobs.verify.judgement import Judged

_CLOSE_UP_PX = 260  # side of the detail


def draw_misalignment(path: Path, judged: Sequence[Judged]) -> Path:
    """Every photograph with an arrow from each real dot towards the drawn one, much enlarged; rows are methods."""
    from matplotlib.figure import Figure

    places = list(dict.fromkeys(one.place for one in judged))
    methods = list(dict.fromkeys(one.method for one in judged))
    figure = Figure(figsize=(3.2 * len(places), 3.4 * len(methods)), layout="constrained")
    axes = figure.subplots(len(methods), len(places), squeeze=False)
    for one in judged:
        drawn = axes[methods.index(one.method), places.index(one.place)]
        photograph = read_photograph(one.off)
        drawn.imshow(photograph, cmap="gray", vmax=2.0 * float(photograph.max()), extent=_extent(photograph))
        drawn.set_xticks([])
        drawn.set_yticks([])
        if one.misalignment is None:
            drawn.set_title("not found", fontsize=8)
            continue
        start, step = one.misalignment.real_px, one.misalignment.virtual_px - one.misalignment.real_px
        arrows = drawn.quiver(
            *start.T, *step.T, one.misalignment.arcmin, angles="xy", scale_units="xy", scale=0.02, cmap="viridis"
        )
        arrows.set_clim(0, 1)
        median = float(np.median(one.misalignment.arcmin))
        drawn.set_title(f"{one.place.name}: {median:.2f}'", fontsize=8)
    for row, method in zip(axes, methods, strict=True):
        row[0].set_ylabel(method)
    figure.suptitle("From each real dot to the drawn one, 50 times enlarged; yellow is 1' and more", fontsize=9)
    return write_figure(path, figure, 110)


def draw_close_up(path: Path, judged: Sequence[Judged]) -> Path:
    """The middle of the first place's photographs: display off, display on, and one over the other."""
    from matplotlib.figure import Figure

    first = [one for one in judged if one.place == judged[0].place]
    figure = Figure(figsize=(9.6, 3.4 * len(first)), layout="constrained")
    axes = figure.subplots(len(first), 3, squeeze=False)
    for row, one in zip(axes, first, strict=True):
        off, on = read_photograph(one.off), read_photograph(one.on)
        centre = np.median(one.misalignment.real_px, axis=0) if one.misalignment else np.array(off.shape[::-1]) / 2
        real, virtual = _detail(off, centre), _detail(on, centre)
        both = np.stack([real, virtual, virtual], axis=-1)
        for drawn, picture, title in zip(
            row, (real, virtual, both), ("display off", "display on", "both"), strict=True
        ):
            drawn.imshow(picture, cmap="gray", vmin=0, vmax=1)
            drawn.set_title(f"{one.method}: {title}", fontsize=8)
            drawn.set_axis_off()
    figure.suptitle("Red and cyan are where only one of the two is bright: real dots beside drawn ones", fontsize=9)
    return write_figure(path, figure, 110)


def _detail(photograph: Photograph, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """A square around a place, 0 to 1 from its darkest to its brightest."""
    height, width = photograph.shape
    left, top = (
        int(np.clip(place - _CLOSE_UP_PX / 2, 0, side - _CLOSE_UP_PX))
        for place, side in zip(centre, (width, height), strict=True)
    )
    part = photograph[top : top + _CLOSE_UP_PX, left : left + _CLOSE_UP_PX].astype(np.float64)
    low, high = np.percentile(part, [1, 99])
    return np.asarray(np.clip((part - low) / max(high - low, 1.0), 0.0, 1.0))


def _extent(photograph: Photograph) -> tuple[float, float, float, float]:
    """For matplotlib: pixels from the outer corner of the top-left one, v down."""
    height, width = photograph.shape
    return 0.0, float(width), float(height), 0.0
