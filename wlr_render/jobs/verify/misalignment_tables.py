"""Tables and pictures of the misalignment in pairs of photographs, display off and on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.atomic_files import output_folder, write_figure
from wlr_render.captures.boards.board import Board
from wlr_render.captures.photographs import Photograph, describe_pixels, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.photograph_pair import PairMisalignment, pair_misalignment
from wlr_render.geometry.lens import Lens
from wlr_render.jobs.options import Options
from wlr_render.report.blocks import Block, Cell, Picture, Plot, Report, ReportTable, cell_text
from wlr_render.report.plots import curves
from wlr_render.report.save import save_report

_CLOSE_UP_PX = 260  # side of the detail
_COLUMNS = ("dots", "median (arcmin)", "rms (arcmin)", "p95 (arcmin)", "max (arcmin)", "sigma per dot (arcmin)")


@dataclass(frozen=True)
class PairPosition:
    """From where a pair was photographed.

    Attributes:
        name: in words.
        depth_m: of the target, where it is known.
        viewpoint: number of the camera's place, where it is known.
        pose: of the target in words; "" where all targets are frontal.
    """

    name: str
    depth_m: float | None = None
    viewpoint: int | None = None
    pose: str = ""


@dataclass(frozen=True, eq=False)
class Judged:
    """One place and way of drawing.

    Attributes:
        position: from where.
        method: how the picture was drawn that the display showed.
        off, on: the photographs.
        misalignment: of their dots; None where one of them shows too little.
        complaint: why not, else empty.
        model: name of the models that drew, where several are compared; else empty.
    """

    position: PairPosition
    method: str
    off: Path
    on: Path
    misalignment: PairMisalignment | None
    complaint: str = ""
    model: str = ""

    @property
    def label(self) -> str:
        """Models and method in words."""
        return f"{self.model}, {self.method}" if self.model else self.method


Said = Callable[[Judged], Cell]
"""What a column of a table says of a pair of photographs."""


def judge_pair(
    position: PairPosition,
    method: str,
    photographs: tuple[Path, Path],
    board: Board,
    camera: Lens,
    shown: NDArray[np.bool_] | None = None,
    model: str = "",
) -> Judged:
    """Match the dots of two photographs.

    Args:
        position: from where they were taken.
        method: of drawing.
        photographs: with the display off, and on.
        board: the target.
        camera: that took them.
        shown: (rows, columns) which dots the panel can show whole; None for all.
        model: name of the models that drew, where several are compared.

    Raises:
        BadInputError: a photograph cannot be read, has another size than the camera's, or another depth than the other.
    """
    off, on = photographs
    images = [read_photograph(path) for path in photographs]
    for path, image in zip(photographs, images, strict=True):
        if image.shape[::-1] != tuple(camera.size_px):
            raise BadInputError(
                f"{path}: is {describe_pixels(image)}, but its camera was calibrated for {camera.size_px[0]} x "
                f"{camera.size_px[1]}; take both photographs with the camera of the calibration."
            )
    if images[0].dtype != images[1].dtype:
        raise BadInputError(f"{on}: is {describe_pixels(images[1])}, {off.name} has another depth; take both alike.")
    try:
        real, virtual = (board.find(image, path.name) for path, image in zip(photographs, images, strict=True))
    except BadInputError as error:
        return Judged(position, method, off, on, None, str(error), model)
    if shown is not None:
        virtual = virtual.only(shown[virtual.index[:, 1], virtual.index[:, 0]])
    return Judged(position, method, off, on, pair_misalignment(real, virtual, camera), model=model)


def by_the_same_dots(judged: Sequence[Judged]) -> list[Judged]:
    """Pairs of one place with the dots that all of them have; those that show too little do not count."""
    found = [{*map(tuple, each.misalignment.index.tolist())} for each in judged if each.misalignment]
    common = set.intersection(*found) if found else set()
    return [replace(each, misalignment=each.misalignment and each.misalignment.only(common)) for each in judged]


def misalignment_report(
    judged: Sequence[Judged],
    name: str,
    folder: Path,
    inputs: Sequence[Path],
    record: Options,
    warnings: Sequence[str] = (),
) -> Report:
    """Write tables and pictures of judged pairs; `name` is that of the models or of the photographs."""
    into = output_folder(folder)
    overall, *others = _tables(judged, name)
    arrows, close_up = (
        _draw_misalignment(into / "misalignment.png", judged),
        _draw_close_up(into / "close_up.png", judged),
    )
    sentences = [
        f"{', '.join(map(str, row[: -len(_COLUMNS)]))}: drawn dots lie {cell_text(row[1 - len(_COLUMNS)])} arcmin "
        "(median) from the real ones."
        for row in overall.rows
    ]
    blocks: list[Block] = [
        overall,
        *([_distribution(judged)] if judged[0].model else []),
        *others,
        Picture("Misalignment", arrows, "From each real dot to the drawn one, enlarged."),
        Picture("Close-up", close_up, "The middle of the first position's photographs."),
    ]
    report = Report(
        f"Verification of {name}",
        verdict=" ".join(sentences),
        warnings=[
            *warnings,
            *(f"{one.position.name}, {one.label}: {one.complaint}" for one in judged if one.complaint),
        ],
        blocks=blocks,
        inputs=inputs,
        files=[arrows, close_up],
        record=record,
    )
    return save_report(report, into)


def _tables(judged: Sequence[Judged], models: str) -> list[ReportTable]:
    """Over everything, by model and method; by target where it stood in several poses; and each pair of photographs."""
    notes = (
        "Angle at the camera between a dot of the real target and the same dot as drawn, from two photographs.",
        "Sigma per dot: standard deviation per axis that the noise of both photographs alone makes.",
        *(
            ["All models are judged by the same dots: those that each shows whole, found in all photographs."]
            if judged[0].model
            else []
        ),
    )
    tables = [_grouped(judged, f"Misalignment from photographs, {models}", {}, notes)]
    posed: dict[str, Said] = {"target (m)": lambda one: one.position.depth_m, "pose": lambda one: one.position.pose}
    if judged[0].position.pose:
        tables.append(_grouped(judged, "By target", posed))
    if all(one.position.depth_m is not None for one in judged):
        place = posed if judged[0].position.pose else {"target (m)": posed["target (m)"]}
        place = {**place, "viewpoint": lambda one: one.position.viewpoint}
    else:
        place = {"photographs": lambda one: one.position.name}
    each = _grouped(judged, "By target distance and viewpoint", place)
    rows = [[*row, one.complaint or None] for row, one in zip(each.rows, judged, strict=True)]
    return [*tables, ReportTable(each.title, (*each.columns, "error"), rows)]


def _grouped(
    judged: Sequence[Judged],
    title: str,
    place: Mapping[str, Said],
    notes: Sequence[str] = (),
) -> ReportTable:
    """A row for each combination of what `place` says, model and method."""
    heads: dict[str, Said] = {
        **place,
        **({"model": lambda one: one.model} if judged[0].model else {}),
        "method": lambda one: one.method,
    }
    groups: dict[tuple[Cell, ...], list[Judged]] = {}
    for one in judged:
        groups.setdefault(tuple(said(one) for said in heads.values()), []).append(one)
    return ReportTable(title, (*heads, *_COLUMNS), [[*key, *_figures(own)] for key, own in groups.items()], notes)


def _distribution(judged: Sequence[Judged]) -> Plot:
    """Curves of all models and methods."""
    percent = np.linspace(0, 100, 201)
    lines = {
        label: (np.percentile(angle, percent), percent)
        for label in dict.fromkeys(one.label for one in judged)
        if len(angle := _angles([one for one in judged if one.label == label]))
    }
    axes = ("misalignment (arcmin)", "dots with less (%)")
    return curves("Distribution of misalignment", lines, axes, log_x=True, caption="All targets and viewpoints.")


def _angles(judged: Sequence[Judged]) -> NDArray[np.float64]:
    found = [one.misalignment.arcmin for one in judged if one.misalignment is not None]
    return np.concatenate(found) if found else np.empty(0)


def _figures(judged: Sequence[Judged]) -> list[Cell]:
    angle = _angles(judged)
    found = [one.misalignment.sigma_arcmin for one in judged if one.misalignment is not None]
    noise = np.concatenate(found) if found else np.empty(0)
    figures = summary(angle)
    return [
        len(angle),
        figures.median,
        figures.rms,
        figures.p95,
        figures.maximum,
        float(np.median(noise)) if len(noise) else None,
    ]


def _draw_misalignment(path: Path, judged: Sequence[Judged]) -> Path:
    """Photographs with an arrow from each real dot towards the drawn one, much enlarged; rows are methods."""
    from matplotlib.figure import Figure

    if judged[0].model:  # as many pictures as can be looked at: each target from the first viewpoint
        judged = [one for one in judged if not one.position.viewpoint]
    places = list(dict.fromkeys(one.position for one in judged))
    methods = list(dict.fromkeys(one.label for one in judged))
    figure = Figure(figsize=(3.2 * len(places), 3.4 * len(methods)), layout="constrained")
    axes = figure.subplots(len(methods), len(places), squeeze=False)
    for one in judged:
        drawn = axes[methods.index(one.label), places.index(one.position)]
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
        drawn.set_title(f"{one.position.name}: {median:.2f}'", fontsize=8)
    for row, method in zip(axes, methods, strict=True):
        row[0].set_ylabel(method)
    figure.suptitle("From each real dot to the drawn one, 50 times enlarged; yellow is 1' and more", fontsize=9)
    return write_figure(path, figure, 110)


def _draw_close_up(path: Path, judged: Sequence[Judged]) -> Path:
    """The middle of the first place's photographs: display off, display on, and one over the other."""
    from matplotlib.figure import Figure

    first = [one for one in judged if one.position == judged[0].position]
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
            drawn.set_title(f"{one.label}: {title}", fontsize=8)
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
