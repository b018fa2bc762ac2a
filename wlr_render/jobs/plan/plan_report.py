"""Report of a planned session: how many places, where, how long, predicted error, and what limits it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wlr_render.evaluation.metrics import Summary
from wlr_render.jobs.places_file import in_random_order
from wlr_render.mappings import EyeBox
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.planned_errors import DesignErrors, EyeTests, place_variance
from wlr_render.planning.search import DesignSearch
from wlr_render.report.blocks import Block, Cell, Number, Plot, Report, ReportTable
from wlr_render.report.plots import axis, curves

_CELLS = 25  # number of cells of the map across the eye box
_FIGURES = ("median (arcmin)", "95 % (arcmin)")
_WORTH = 0.05  # smallest share of the error removed by a change that the report names


def plan_report(search: DesignSearch, accuracy_arcmin: float, seconds: float) -> Report:
    """Return the report of a planned session; each photograph takes `seconds`."""
    bench, design = search.predictor.bench, search.recommended.design
    photographs = bench.photographs(len(design))
    total = sum(photographs.values())
    errors, simulated = search.recommended.errors, search.simulated
    found = errors.registration
    what = (
        f"{len(design)} camera places, {total} photographs, {_duration(total * seconds)} at {seconds:g} s each: "
        f"registration error {found.median:.2g}' in the median, {found.p95:.2g}' at 95 % of the eye box, as predicted "
        f"from a simulated session of this design (in that session: {simulated.registration.median:.2g}', "
        f"{simulated.registration.p95:.2g}')"
    )
    verdict = f"{what}; this reaches the wanted {accuracy_arcmin:g}'."
    if not search.reaches:
        verdict = f"The wanted {accuracy_arcmin:g}' is not reached. The best design found: {what}."
    models = search.predictor.models(design.unit)
    blocks: list[Block] = [
        _errors_table(errors, simulated),
        _designs_table(search),
        _curves(search, accuracy_arcmin),
        _limits_table(search),
        error_map(*models, bench.truth.eye_box, bench.places(design.unit), search.predictor.tests),
        ReportTable(
            "Photographs",
            ["photograph", "number", "minutes"],
            [[name, count, count * seconds / 60.0] for name, count in photographs.items()],
            ("The display's codes and the board are photographed at every camera place; the rest once a session.",),
        ),
        places_table(bench.places(design.unit) - bench.truth.eye_box.centre),
    ]
    return Report(
        f"Plan of a session: {bench.truth.name}, {bench.truth.eye} eye",
        verdict,
        advice=_advice(search),
        warnings=_warnings(search),
        blocks=blocks,
        record={
            "design": design.name,
            "photographs": photographs,
            "predicted": errors,
            "simulated": simulated,
            "limits": search.limits,
        },
    )


def places_table(places: FloatArray) -> ReportTable:
    """Tabulate places (m, 3) from the centre of the eye box, in random order."""
    rows: list[list[Cell]] = [
        [number, *(Number(1e3 * each, "+z.3f") for each in place)]
        for number, place in enumerate(in_random_order(places))
    ]
    notes = (
        "From the centre of the eye box, device frame: x to the right, y up, z backward. Also in places.csv.",
        "Photograph the places in this order, which is random: in a raster, a warm-up or errors of the stage by its "
        "direction of travel vary smoothly with the place, and a calibration mistakes them for optics.",
    )
    return ReportTable("Camera places", ["place", "x (mm)", "y (mm)", "z (mm)"], rows, notes)


def error_map(
    display: FittedDisplay, see_through: FittedSeeThrough, eye_box: EyeBox, places: FloatArray, tests: EyeTests
) -> Plot:
    """Plot the predicted registration error over the middle plane of the eye box, with camera places (m, 3)."""
    half = 0.5 * eye_box.size[:2]
    x, y = (np.linspace(-each, each, _CELLS) for each in half)
    grid = np.stack([*np.meshgrid(x, y), np.zeros((_CELLS, _CELLS))], axis=-1).reshape(-1, 3)
    error = np.sqrt(place_variance(display, see_through, eye_box.centre + grid, tests)).reshape(_CELLS, _CELLS)
    away = 1e3 * (places - eye_box.centre)
    data = [
        {
            "type": "heatmap",
            "x": np.round(1e3 * x, 3).tolist(),
            "y": np.round(1e3 * y, 3).tolist(),
            "z": [[float(f"{value:.4g}") for value in row] for row in error],
            "colorscale": "Viridis",
            "colorbar": {"title": {"text": "arcmin"}},
        },
        {
            "type": "scatter",
            "mode": "markers",
            "name": "camera places",
            "x": np.round(away[:, 0], 3).tolist(),
            "y": np.round(away[:, 1], 3).tolist(),
            "marker": {"size": 9, "color": "#d62728", "symbol": "circle-open", "line": {"width": 2}},
        },
    ]
    layout = {
        "xaxis": axis("x (mm)") | {"constrain": "domain"},
        "yaxis": axis("y (mm)") | {"scaleanchor": "x", "constrain": "domain"},
    }
    caption = (
        "Rms predicted registration error at viewpoints in the middle plane of the eye box; circles: camera places. "
        "Rays to viewpoints in front of and behind that plane cross it outside the eye box; places lie there, too."
    )
    return Plot("Predicted error over the eye box", data, layout, caption, height_px=560)


def _duration(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def _errors_table(predicted: DesignErrors, simulated: DesignErrors) -> ReportTable:
    rows: list[list[Cell]] = []
    for name in ("display", "see_through", "registration"):
        one: Summary = getattr(predicted, name)
        other: Summary = getattr(simulated, name)
        rows.append([name.replace("_", "-"), one.median, one.p95, other.median, other.p95, one.rms, other.rms])
    columns = ["error", "predicted median (arcmin)", "predicted 95 % (arcmin)", "simulated median (arcmin)"]
    columns += ["simulated 95 % (arcmin)", "predicted rms (arcmin)", "simulated rms (arcmin)"]
    notes = (
        "Over the eye box and the field of view. Predicted: from the covariance of the models and the error of the "
        "stage's calibration. Simulated: one session's models against the traced headset.",
        "The error of the stage's calibration is the same in display and see-through, and mostly cancels in "
        "registration.",
        "Errors of the tracking camera's extrinsics and of eye tracking are not included.",
    )
    return ReportTable("Errors of the recommended design", columns, rows, notes)


def _limits_table(search: DesignSearch) -> ReportTable:
    now = search.recommended.errors
    rows: list[list[Cell]] = [["as planned", now.registration.median, now.registration.p95, None, now.display.p95]]
    for name, errors in search.limits.items():
        gain = 100.0 * (1.0 - errors.registration.p95 / now.registration.p95)
        rows.append([name, errors.registration.median, errors.registration.p95, gain, errors.display.p95])
    columns = ["change", "registration, median (arcmin)", "registration, 95 % (arcmin)", "gain (%)"]
    return ReportTable("What limits the accuracy", [*columns, "display, 95 % (arcmin)"], rows)


def _designs_table(search: DesignSearch) -> ReportTable:
    """Return the predicted errors of every design that was tried, by number of camera places."""
    rows: list[list[Cell]] = []
    every = [each for tried in search.tried.values() for each in tried]
    for each in sorted(every, key=lambda one: len(one.design)):
        total = sum(search.predictor.bench.photographs(len(each.design)).values())
        sizes = (each.errors.display, each.errors.see_through, each.errors.registration)
        figures = [figure for size in sizes for figure in (size.median, size.p95)]
        mark = "recommended" if each.design is search.recommended.design else ""
        rows.append([len(each.design), each.design.name, total, *figures, mark])
    columns = ["places", "design", "photographs"]
    columns += [f"{size}, {figure}" for size in ("display", "see-through", "registration") for figure in _FIGURES]
    notes = (
        "All predicted from one simulated session, the pilot, so that designs can be compared. The session of the "
        f"recommended design itself then predicts {search.recommended.p95:.3g}' at 95 %, the figure stated above.",
        "Spread: no two places share a column or a row. Chosen: the places with the least predicted variance over the "
        "eye box.",
    )
    return ReportTable("Predicted error by number of camera places", [*columns, ""], rows, notes)


def _curves(search: DesignSearch, accuracy_arcmin: float) -> Plot:
    """Return the registration error by number of camera places, with a bar from the median to 95 % of the eye box."""
    found = {family: sorted(tried, key=lambda one: len(one.design)) for family, tried in search.tried.items()}
    found["recommended, from its own session"] = [search.recommended]
    lines = {
        name: ([len(each.design) for each in tried], [each.errors.registration.median for each in tried])
        for name, tried in found.items()
    }
    counts = [count for xs, _ in lines.values() for count in xs]
    wanted = ([min(counts) - 0.5, max(counts) + 0.5], [accuracy_arcmin, accuracy_arcmin])  # a line for one count, too
    caption = (
        "Points: median over the eye box and the field of view. Bars end at the error of 95 % of it, which should lie "
        "below the wanted one."
    )
    axes = ("camera places", "registration error (arcmin)")
    plot = curves("Predicted error by number of camera places", lines | {"wanted": wanted}, axes, caption=caption)
    bars = [
        {"array": [each.p95 - each.errors.registration.median for each in tried], "arrayminus": [0.0] * len(tried)}
        for tried in found.values()
    ]
    with_bars = [
        {**trace, "mode": "lines+markers", "error_y": {**bar, "symmetric": False}}
        for trace, bar in zip(plot.data, bars, strict=False)
    ]
    return replace(plot, data=[*with_bars, plot.data[-1]])


def _gains(search: DesignSearch) -> list[tuple[float, str, float]]:
    """Return relative gain, name and 95 % registration error of each change, the largest gain first."""
    now = search.recommended.p95
    found = [(1.0 - each.registration.p95 / now, name, each.registration.p95) for name, each in search.limits.items()]
    return sorted(found, reverse=True)


def _advice(search: DesignSearch) -> list[str]:
    steps = [
        "Drive the stage to the places of places.csv, measured from the centre of the eye box.",
        "Turn the board by 90 degrees in its plane at one of its poses: its printing errors turn with it, errors of "
        "the optics do not.",
    ]
    gains = [each for each in _gains(search) if each[0] > _WORTH]
    if not gains:
        return [*steps, "No single change of the bench improves registration by more than 5 %."]
    first, *others = [f"{name} ({p95:.2g}')" for _, name, p95 in gains]
    return [*steps, f"Most would be gained by {first}" + (f", then by {others[0]}." if others else ".")]


def _warnings(search: DesignSearch) -> Sequence[str]:
    predicted, simulated = search.recommended.errors.registration.rms, search.simulated.registration.rms
    if simulated <= 1.5 * predicted:
        return []
    return [
        f"The simulated session's registration error is {simulated / predicted:.1f} times the predicted one: the model "
        "cannot follow these optics between so few places, or its fit did not find how smooth they are."
    ]
