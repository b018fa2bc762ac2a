"""Self-calibration over half an hour of simulated wear with slips."""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.intervals import INTERVAL, interval_percent
from benchmarks.wear.simulated_wear import (
    MINUTES,
    MOST_CLICKS,
    SLIP_M,
    SLIPS,
    Slip,
    Wear,
    WearResult,
    calibrated,
    half_hour,
    worn_eye,
)
from wlr_render.io.atomic_files import output_folder, write_figure
from wlr_render.jobs.options import ProgressArgument, Range, Scheduler, Seed, SpreadOptions, Workers, described
from wlr_render.report.blocks import Cell, Picture, Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT
from wlr_render.work.workers import as_finished

CLICKS = 5
WANTED = 1.5
"""Largest wanted ratio of the misalignment after `CLICKS` clicks to the misalignment before the slip."""
_DRAWS = 2000  # number of bootstrap draws


@dataclass(frozen=True)
class WearOptions(SpreadOptions):
    """Options of `wear`."""

    device: Annotated[tuple[str, ...], described("Shipped devices.", name=("--devices", "--device"), many=True)] = (
        "northstar",
        "freeform40",
        "birdbath28",
    )
    _: KW_ONLY
    models: Annotated[int, described("Calibrations of each device."), Range(at_least=1, at_most=100)] = 2
    wears: Annotated[int, described("Half hours of wear of each calibration."), Range(at_least=2, at_most=1000)] = 20
    click_arcmin: Annotated[float, described("Scatter of clicks per axis."), Range(at_least=0.1, at_most=30.0)] = 2.0
    unseen: Annotated[
        float,
        described("Share of a slip that the eye tracker misses; 1 for a headset without one."),
        Range(at_least=0.0, at_most=1.0),
    ] = 0.5
    seed: Seed = 1
    workers: Workers = None
    scheduler: Scheduler = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/wear")


@dataclass(frozen=True)
class _Task:
    device: str
    model: int


def run(options: WearOptions = WearOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Simulate the wears, and write wear.html, .md, .json and .png.

    Raises:
        BadInputError: a device is faulty, or the output folder cannot be written.
    """
    folder = output_folder(options.out)
    tasks = [_Task(device, model) for model in range(options.models) for device in dict.fromkeys(options.device)]
    finished = as_finished(partial(_worn, options), tasks, options.worker_pool)
    found = dict(progress(finished, len(tasks), "calibrations"))
    results: dict[str, list[WearResult]] = {device: [] for device in options.device}
    for task in tasks:
        results[task.device] += found[task]
    tables = [_around_slips(results), _by_clicks(results)]
    ratios = {device: _ratio(wears) for device, wears in results.items()}
    met = all(high <= WANTED for _, _, high in ratios.values())
    words = ", ".join(
        f"{device} {ratio:.2f} ({low:.2f} to {high:.2f})" for device, (ratio, low, high) in ratios.items()
    )
    report = Report(
        "Self-calibration in use",
        verdict=f"After a slip and {CLICKS} clicks the misalignment is this many times that before the slip, rms over "
        f"field, depth and slips, with 95 % intervals: {words}. Wanted: at most {WANTED:g}, which is "
        f"{'met' if met else 'not met by all upper ends'}.",
        blocks=[*tables, _over_time(folder / "wear.png", results)],
        record={
            "options": asdict(options),
            "wears": {name: [asdict(one) for one in each] for name, each in results.items()},
        },
    )
    return save_report(report, folder, "wear")


def _worn(options: WearOptions, task: _Task) -> tuple[_Task, list[WearResult]]:
    key = sum(map(ord, task.device)), task.model
    rng = np.random.default_rng(np.random.SeedSequence(options.seed, spawn_key=key))
    truth = worn_eye(task.device)
    models = calibrated(truth, rng)
    wear = Wear(click_arcmin=options.click_arcmin, unseen=options.unseen)
    return task, [half_hour(truth, models, wear, rng) for _ in range(options.wears)]


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _slips(wears: Sequence[WearResult]) -> list[Slip]:
    return [slip for wear in wears for slip in wear.slips]


def _ratio(wears: Sequence[WearResult]) -> tuple[float, float, float]:
    """Return misalignment after the clicks over that before the slip, and its 95 % interval by bootstrap over wears."""
    squares = np.array([[[slip.after[CLICKS] ** 2, slip.before**2] for slip in wear.slips] for wear in wears]).mean(1)
    drawn = squares[np.random.default_rng(0).integers(0, len(squares), (_DRAWS, len(squares)))].mean(axis=1)
    low, high = np.quantile(np.sqrt(drawn[:, 0] / drawn[:, 1]), (0.025, 0.975))
    after, before = squares.mean(axis=0)
    return float(np.sqrt(after / before)), float(low), float(high)


def _around_slips(results: Mapping[str, Sequence[WearResult]]) -> ReportTable:
    rows: list[list[Cell]] = []
    for device, wears in results.items():
        slips = _slips(wears)
        ratio, low, high = _ratio(wears)
        within = sum(slip.after[CLICKS] <= WANTED * slip.before for slip in slips)
        named = [slip.is_named for slip in slips if slip.is_named is not None]
        rows.append(
            [
                device,
                len(slips),
                _rms([slip.before for slip in slips]),
                _rms([slip.after[0] for slip in slips]),
                _rms([slip.after[CLICKS] for slip in slips]),
                _rms([slip.uncorrected for slip in slips]),
                ratio,
                f"{low:.2f} to {high:.2f}",
                f"{within} of {len(slips)}",
                interval_percent(within, len(slips)),
                f"{sum(named)} of {len(named)}",
            ]
        )
    columns = ["device", "slips", "before (arcmin)", "after the slip", f"after {CLICKS} clicks", "never corrected"]
    columns += ["after / before", "95 % interval", f"slips within {WANTED:g}", INTERVAL, "wrong clicks named"]
    low_mm, high_mm = 1e3 * SLIP_M[0], 1e3 * SLIP_M[1]
    notes = (
        f"Rms over field, three depths and slips. {SLIPS} slips of {low_mm:g} to {high_mm:g} mm in {MINUTES:g} min; "
        f"{MOST_CLICKS} clicks when the headset is put on and after each slip, of which the state is not told.",
        "Never corrected: the calibrated models and the tracked viewpoint, after the slip.",
    )
    return ReportTable("Around slips", columns, rows, notes)


def _by_clicks(results: Mapping[str, Sequence[WearResult]]) -> ReportTable:
    rows: list[list[Cell]] = []
    counts = range(MOST_CLICKS + 1)
    for device, wears in results.items():
        slips = _slips(wears)
        rows.append([device, "true", *(_rms([slip.after[count] for slip in slips]) for count in counts)])
        rows.append([device, "predicted", *(_rms([slip.predicted[count] for slip in slips]) for count in counts)])
    columns = ["device", "misalignment", *(f"{count} clicks" for count in counts)]
    note = "Without clicks the state does not know of the slip. Clicks that contradict each other change nothing."
    return ReportTable("Misalignment by number of clicks after a slip, rms in arcmin", columns, rows, (note,))


def _over_time(path: Path, results: Mapping[str, Sequence[WearResult]]) -> Picture:
    """Plot one wear of each device over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 2.2 * len(results)), dpi=110, layout="constrained")
    rows = figure.subplots(len(results), 1, sharex=True, squeeze=False)[:, 0]
    for row, (device, wears) in zip(rows, results.items(), strict=True):
        wear = wears[0]
        row.plot(wear.minutes, wear.uncorrected, color="#bbbbbb", label="never corrected")
        row.plot(wear.minutes, wear.corrected, color="#1f77b4", label="corrected by clicks")
        for number, slip in enumerate(wear.slips):
            row.axvline(slip.minute, color="#d62728", linewidth=0.8, label=None if number else "slip")
        row.set(ylabel=f"{device}\nrms (arcmin)", xlim=(0.0, MINUTES), ylim=(0.0, None))
        row.spines[["top", "right"]].set_visible(False)
    rows[0].legend(fontsize=8, frameon=False, ncols=3, loc="upper left", bbox_to_anchor=(0.0, 1.3))
    rows[-1].set_xlabel("time (min)")
    caption = f"The first wear of each device: slips, and {MOST_CLICKS} clicks right after each."
    return Picture("Misalignment over time", write_figure(path, figure), caption)
