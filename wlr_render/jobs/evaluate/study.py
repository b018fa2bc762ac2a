"""Planar against volumetric sampling and the baselines: a Monte Carlo study on simulated captures of traced devices."""

from dataclasses import asdict, dataclass
from pathlib import Path

from wlr_render import files
from wlr_render.errors import BadInputError
from wlr_render.jobs.evaluate import plots as sampling_plots
from wlr_render.jobs.evaluate.capture_experiments import NOISE_EXPERIMENT, POSITION_EXPERIMENT, VIEWPOINT_EXPERIMENT
from wlr_render.jobs.evaluate.dense_experiments import (
    DENSE_EXPERIMENT,
    DEPTH_EXPERIMENT,
    EYE_BOX_EXPERIMENT,
    FIELD_EXPERIMENT,
)
from wlr_render.jobs.evaluate.experiment import Experiment, Plot, StudyOptions
from wlr_render.jobs.evaluate.pool import run_all
from wlr_render.jobs.evaluate.see_through_experiment import SEE_THROUGH_EXPERIMENT
from wlr_render.jobs.evaluate.world import EYE_BOX_MM, TEST_RAYS, TEST_VIEWPOINTS, Setting, truth
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT, Progress
from wlr_render.report.blocks import Cell, ReportTable, tables_as_json

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        DENSE_EXPERIMENT,
        VIEWPOINT_EXPERIMENT,
        NOISE_EXPERIMENT,
        POSITION_EXPERIMENT,
        DEPTH_EXPERIMENT,
        EYE_BOX_EXPERIMENT,
        FIELD_EXPERIMENT,
        SEE_THROUGH_EXPERIMENT,
    )
}

QUICK = StudyOptions()
"""About a minute on two cores."""
FULL = StudyOptions(devices=(*QUICK.devices, "prism5701202"), degrees=(3, 4, 5, 6, 7), repeats=10)
"""Everything, in some ten minutes."""


@dataclass(frozen=True)
class StudyReport:
    """What a study found."""

    options: StudyOptions
    tables: tuple[ReportTable, ...]
    plots: tuple[Plot, ...]


def run(options: StudyOptions = QUICK, progress: Progress = SILENT) -> StudyReport:
    """Run the experiments; trials that several of them need are run once.

    Raises:
        BadInputError: an unknown experiment or device, no device, no degree or no repetition.
    """
    chosen = [_experiment(name) for name in options.experiments or EXPERIMENTS]
    _check(options)
    cells = [experiment.cells(options) for experiment in chosen]
    trials = [trial for each in cells for trial in each.values()]
    outcomes = run_all(trials, options.seed, options.workers, progress)
    found = [
        experiment.findings(options, {key: outcomes[trial] for key, trial in each.items()})
        for experiment, each in zip(chosen, cells, strict=True)
    ]
    tables = tuple(table for findings in found for table in findings.tables)
    return StudyReport(
        options, (_conditions(options), *tables), tuple(plot for findings in found for plot in findings.plots)
    )


def write(report: StudyReport, folder: str | Path) -> list[Path]:
    """Write study.md, study.json and one picture per plot into a folder; return their paths."""
    into = files.output_folder(folder)
    pictures = [sampling_plots.draw(plot, into / f"{plot.name}.png") for plot in report.plots]
    shown = [f"![{plot.title}]({plot.name}.png)\n" for plot in report.plots]
    text = "\n".join(["# Sampling study\n", *(table.markdown() for table in report.tables), *shown])
    record = tables_as_json(report.tables, options=asdict(report.options))
    return [files.write_text(into / "study.md", text), files.write_text(into / "study.json", record), *pictures]


def _conditions(options: StudyOptions) -> ReportTable:
    rows: list[list[Cell]] = []
    for device in options.devices:
        rows.append([device, str(truth(Setting(device)).field or "whole panel")])
    box = " x ".join(f"{edge:g}" for edge in EYE_BOX_MM) + " mm"
    notes = (
        "Captures are taken and errors are stated in this field. It is a choice, and they depend on it: the table"
        " 'Size of the field' has the whole panel beside it.",
        f"Each rms is over {TEST_RAYS} rays from each of {TEST_VIEWPOINTS} random viewpoints in an eye box of {box}.",
    )
    return ReportTable("Conditions", ["device", "field, horizontal x vertical"], rows, notes)


def _check(options: StudyOptions) -> None:
    if options.repeats < 1:
        raise BadInputError(f"the number of repetitions is {options.repeats}; give at least 1.")
    if not options.degrees or not options.devices:
        raise BadInputError(f"there is no {'device' if options.degrees else 'degree'} to study; give at least one.")
    for device in options.devices:
        load_device(device)


def _experiment(name: str) -> Experiment:
    if name not in EXPERIMENTS:
        raise BadInputError(f"there is no experiment '{name}'; choose from {', '.join(EXPERIMENTS)}.")
    return EXPERIMENTS[name]
