"""Measure the misalignment of a drawn target in photographs with the display off and on, from the same position."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.bench.station_file import read_lens, read_station
from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.photographs import Photograph, photographs_in, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.photograph_pair import JudgedPair, judge_pair
from wlr_render.io.atomic_files import output_folder, write_figure
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, EyeName, Options, ProgressArgument, described
from wlr_render.report.blocks import Cell, Columns, Picture, Report, ReportTable, cell_text, table
from wlr_render.work.progress import SILENT

NOTES = (
    "Angle at the camera between a dot of the real target and the same dot as drawn, from two photographs.",
    "Sigma per dot: standard deviation per axis that the noise of both photographs alone makes.",
)
_OFF = re.compile(r"(?P<name>.+)_off")
_ON = re.compile(r"(?P<name>.+)_on(_(?P<method>.+))?")
_CLOSE_UP_PX = 260  # side of the close-up, camera pixels
_COLUMNS = {
    "dots": "angle.count",
    "median (arcmin)": "angle.median",
    "rms (arcmin)": "angle.rms",
    "p95 (arcmin)": "angle.p95",
    "max (arcmin)": "angle.maximum",
    "sigma per dot (arcmin)": "sigma_arcmin",
}
"""Columns of a table of `_DotErrors`."""


@dataclass(frozen=True)
class VerifyOptions(Options):
    """Options of `verify`."""

    photographs: Annotated[
        Path,
        described("Folder of photographs NAME_off.png, and NAME_on.png or NAME_on_METHOD.png from the same position."),
    ]
    board: Annotated[Path, described("File board.toml of the target in the photographs.")]
    _: KW_ONLY
    calibration: Annotated[Path, described("Output folder of `calibrate`, for the lens of the camera.")] = Path(
        "out/calibrate"
    )
    eye: Annotated[EyeName, described("Eye that the camera was calibrated for.")] = "right"
    out: Annotated[Path, described("Output folder.")] = Path("out/verify")
    against: Against = None


@dataclass(frozen=True)
class _DotErrors:
    """Misalignment of the dots of some pairs, starting with `first`, and the median of their sigmas."""

    first: JudgedPair
    angle: Summary
    sigma_arcmin: float | None

    @classmethod
    def of(cls, pairs: Sequence[JudgedPair]) -> "_DotErrors":
        matched = [pair.misalignment for pair in pairs if pair.misalignment is not None]
        angle, sigma = (
            np.concatenate([getattr(each, name) for each in matched] or [np.empty(0)])
            for name in ("arcmin", "sigma_arcmin")
        )
        return cls(pairs[0], summary(angle), float(np.median(sigma)) if len(sigma) else None)


@job
def verify(options: VerifyOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Measure the distance between drawn and real dots; write pictures and the report into `options.out`.

    Raises:
        BadInputError: the folder has no pair, a photograph with the display on has no partner with the display off, or
            a file is missing.
    """
    progress.say("finding dots")
    station = options.calibration / f"station-{options.eye}.json"
    judged = _judge_pairs(options.photographs, options.board, station)
    folder, name = output_folder(options.out), options.photographs.name
    overall = misalignment_table(judged, f"Misalignment from photographs, {name}", {"method": by_method}, NOTES)
    pictures = misalignment_pictures(judged, folder)
    return Report(
        f"Verification of {name}",
        verdict=verdict(judged),
        warnings=complaints(judged),
        blocks=[overall, table_of_pairs(judged), *pictures],
        inputs=[options.photographs, options.board, station],
        files=[picture.path for picture in pictures],
    )


def _judge_pairs(folder: Path, board_file: Path, station: Path) -> list[JudgedPair]:
    """Compare NAME_off.png with every NAME_on.png or NAME_on_METHOD.png in the same folder."""
    photographs = photographs_in(folder)
    board, camera = load_board(board_file), read_lens(read_station(station).table("eyeball_camera"))
    off = {match["name"]: path for path in photographs if (match := _OFF.fullmatch(path.stem))}
    judged = []
    for path in photographs:
        match = _ON.fullmatch(path.stem)
        if match is None or path in off.values():
            continue
        name, method = match["name"], match["method"] or "on"
        if name not in off:
            raise BadInputError(f"{path}: its photograph with the display off is missing; name it {name}_off.png.")
        judged.append(judge_pair(name, method, (off[name], path), board, camera))
    if not judged:
        raise BadInputError(
            f"{folder}: holds no pairs of photographs named NAME_off.png and NAME_on.png; name them so."
        )
    return judged


by_method: Callable[[JudgedPair], Cell] = attrgetter("method")
"""A column of `misalignment_table`: how the picture was drawn."""


def misalignment_table(
    judged: Sequence[JudgedPair],
    title: str,
    heads: Mapping[str, Callable[[JudgedPair], Cell]],
    notes: Sequence[str] = (),
) -> ReportTable:
    """Return figures of the misalignment, with a row for each combination of values of the first columns, `heads`."""
    groups: dict[tuple[Cell, ...], list[JudgedPair]] = {}
    for pair in judged:
        groups.setdefault(tuple(value(pair) for value in heads.values()), []).append(pair)

    def of_first(value: Callable[[JudgedPair], Cell]) -> Callable[[_DotErrors], Cell]:
        return lambda errors: value(errors.first)

    columns: Columns = {**{head: of_first(value) for head, value in heads.items()}, **_COLUMNS}
    return table(title, map(_DotErrors.of, groups.values()), columns, notes)


def table_of_pairs(judged: Sequence[JudgedPair]) -> ReportTable:
    """Tabulate the figures of each pair of photographs, or the reason why a pair has none."""
    heads = {"photographs": "first.name", "method": "first.method"}
    columns: Columns = {**heads, **_COLUMNS, "error": lambda errors: errors.first.complaint or None}
    return table("By photograph", [_DotErrors.of([pair]) for pair in judged], columns)


def verdict(judged: Sequence[JudgedPair]) -> str:
    """Return a sentence for each method."""
    by_method = {method: [pair for pair in judged if pair.method == method] for method in _methods(judged)}
    return " ".join(
        f"{method}: drawn dots lie {cell_text(_DotErrors.of(pairs).angle.median)} arcmin (median) from the real ones."
        for method, pairs in by_method.items()
    )


def _methods(judged: Sequence[JudgedPair]) -> list[str]:
    return list(dict.fromkeys(pair.method for pair in judged))


def complaints(judged: Sequence[JudgedPair]) -> list[str]:
    """Return a warning for each pair that cannot be compared."""
    return [f"{pair.name}, {pair.method}: {pair.complaint}" for pair in judged if pair.complaint]


def misalignment_pictures(judged: Sequence[JudgedPair], folder: Path) -> list[Picture]:
    """Draw the misalignment of each pair, and a detail of the first position, into a folder."""
    arrows = _draw_misalignment(folder / "misalignment.png", judged)
    close_up = _draw_close_up(folder / "close_up.png", judged)
    return [
        Picture("Misalignment", arrows, "From each real dot to the drawn one, enlarged."),
        Picture("Close-up", close_up, "The middle of the first position's photographs."),
    ]


def _draw_misalignment(path: Path, judged: Sequence[JudgedPair]) -> Path:
    """Draw photographs with an arrow from each real dot to the drawn one, enlarged; a row for each method."""
    from matplotlib.figure import Figure

    places = list(dict.fromkeys(one.name for one in judged))
    methods = _methods(judged)
    figure = Figure(figsize=(3.2 * len(places), 3.4 * len(methods)), layout="constrained")
    axes = figure.subplots(len(methods), len(places), squeeze=False)
    for one in judged:
        drawn = axes[methods.index(one.method), places.index(one.name)]
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
        drawn.set_title(f"{one.name}: {median:.2f}'", fontsize=8)
    for row, method in zip(axes, methods, strict=True):
        row[0].set_ylabel(method)
    figure.suptitle("From each real dot to the drawn one, 50 times enlarged; yellow is 1' and more", fontsize=9)
    return write_figure(path, figure, 110)


def _draw_close_up(path: Path, judged: Sequence[JudgedPair]) -> Path:
    """Draw the middle of the first position's photographs: display off, display on, and both overlaid."""
    from matplotlib.figure import Figure

    first = [one for one in judged if one.name == judged[0].name]
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
    """Return a square around a position, scaled from 0 to 1."""
    height, width = photograph.shape
    left, top = (
        int(np.clip(place - _CLOSE_UP_PX / 2, 0, side - _CLOSE_UP_PX))
        for place, side in zip(centre, (width, height), strict=True)
    )
    part = photograph[top : top + _CLOSE_UP_PX, left : left + _CLOSE_UP_PX].astype(np.float64)
    low, high = np.percentile(part, [1, 99])
    return np.asarray(np.clip((part - low) / max(high - low, 1.0), 0.0, 1.0))


def _extent(photograph: Photograph) -> tuple[float, float, float, float]:
    """Return the extent of a photograph for matplotlib, in pixels, v down."""
    height, width = photograph.shape
    return 0.0, float(width), float(height), 0.0
