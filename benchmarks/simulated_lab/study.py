"""Accuracy of readings from photographs: codes at low signal, whole sessions and their registration, benches."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.kept_trials import finished_trials
from benchmarks.simulated_lab.bench_tables import bench_tables
from benchmarks.simulated_lab.bench_trial import (
    FAULTY,
    BenchOutcome,
    BenchTrial,
    BenchTrialKind,
    loaded_outcome,
    run_bench_trial,
)
from benchmarks.simulated_lab.codes import code_table, code_trials
from benchmarks.simulated_lab.lab_options import SimulatedLabOptions
from benchmarks.simulated_lab.recipe_file import load_recipe
from benchmarks.simulated_lab.registration import register
from benchmarks.simulated_lab.session_truth import compare_with_truth, truth_tables
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions
from wlr_render.jobs.calibrate.photos import calibrated
from wlr_render.jobs.options import ProgressArgument
from wlr_render.optics.device_file import load_device
from wlr_render.report.blocks import Block, Report, ReportTable
from wlr_render.report.save import markdown, save_report
from wlr_render.simulation.photographs.photo_bench import design_photo_bench
from wlr_render.work.progress import SILENT, Progress

_DEVICE = "freeform40"  # its panel has 1920 x 1080 pixels
_TRIALS = "trials"


_DEFAULTS = SimulatedLabOptions()


def run(options: SimulatedLabOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Photograph, read and compare; write simulated-lab.html, .md and .json.

    Raises:
        BadInputError: the session is not simulated, or cannot be calibrated.
    """
    folder = output_folder(options.out)
    tables = _tables(options, progress)
    registration = register(options, folder, progress) if "registration" in options.part else None
    blocks: list[Block] = [*tables, *(registration.blocks(folder) if registration else [])]
    inputs = [] if options.session is None else [options.session]
    outcomes: list[BenchOutcome] = []
    tasks = bench_trials(options)
    try:
        for outcome in _outcomes(tasks, options, folder, progress):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda each: tasks.index(each.trial))
        record = {"seed": options.seed, "trials": outcomes}
        title = "Photographs compared with the truth"
        title += f": {len(outcomes)} of {len(tasks)} benches" if tasks else ""
        report = Report(
            title,
            registration.verdict if registration else "",
            warnings=registration.warnings if registration else [],
            blocks=[*blocks, *bench_tables(outcomes)],
            inputs=inputs,
            record=record,
        )
        report = save_report(report, folder, "simulated-lab")
        if options.record is not None:
            name = f"simulated-lab-{'-'.join(options.part)}.md"
            write_text(options.record / name, markdown(report, options.record))
    return report


def _tables(options: SimulatedLabOptions, progress: Progress) -> list[ReportTable]:
    """Measure codes, and the calibration of a session against its truth, as requested."""
    tables: list[ReportTable] = []
    if "codes" in options.part:
        bench = design_photo_bench(load_device(_DEVICE), "right")
        trials = list(progress(code_trials(bench, options.snr, options.seed), 3, "codes"))
        tables = [code_table(trials, bench, options.snr)]
    if "truth" in options.part:
        truth = load_recipe(options.simulated_session).build()
        given = CalibrateOptions(str(options.simulated_session), out=options.calibration[0])
        compared = compare_with_truth(truth, calibrated(given, progress=progress), options.seed)
        tables += truth_tables(compared, options.seed)
    return tables


def bench_trials(options: SimulatedLabOptions) -> list[BenchTrial]:
    """Return trials of benches, mixed so that an interrupted study has some of each kind."""
    counts: dict[BenchTrialKind, int] = {}
    if "bench" in options.part:
        counts[BenchTrialKind.CLEAN] = options.benches
    if "faults" in options.part:
        counts |= dict.fromkeys(FAULTY, options.faults)
    if "models" in options.part:
        counts[BenchTrialKind.MODELS] = options.models
    trials = [
        BenchTrial(kind, number, options.family, options.dots)
        for kind, count in counts.items()
        for number in range(count)
    ]
    return sorted(trials, key=lambda trial: (trial.number + 0.5) / counts[trial.kind])


def _outcomes(
    tasks: Sequence[BenchTrial], options: SimulatedLabOptions, folder: Path, progress: Progress
) -> Iterable[BenchOutcome]:
    if not tasks:
        return ()
    finished = finished_trials(
        run_bench_trial,
        loaded_outcome,
        tasks,
        seed=options.seed,
        folder=folder / _TRIALS,
        resume=options.resume,
        workers=options.worker_pool,
    )
    return progress(finished, len(tasks), "benches")
