"""Accuracy of reading photographs: codes at low signal, a whole session if one is given, and calibrated benches."""

from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

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
from benchmarks.simulated_lab.session_truth import compare_with_truth, truth_tables
from wlr_render.atomic_files import output_folder, write_text
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions
from wlr_render.jobs.calibrate.photos import calibrated
from wlr_render.jobs.options import (
    OnlyWith,
    ProgressArgument,
    Range,
    Scheduler,
    Seed,
    SpreadOptions,
    Workers,
    described,
)
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT, Progress
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.save import markdown, save_report
from wlr_render.simulation.photographs.photo_bench import design_photo_bench
from wlr_render.simulation.photographs.recipe import load_recipe

PartName = Literal["codes", "bench", "faults", "models"]

_DEVICE = "freeform40"  # its panel has 1920 x 1080 pixels
_TRIALS = "trials"


@dataclass(frozen=True)
class SimulatedLabOptions(SpreadOptions):
    """Options of `simulated-lab`."""

    _: KW_ONLY
    part: Annotated[
        tuple[PartName, ...],
        described("Measurements to make, one or more of codes, bench, faults and models.", many=True),
    ] = ("codes",)
    benches: Annotated[
        int, described("Sessions of simulated benches."), Range(at_least=1), OnlyWith("part", ("bench",))
    ] = 40
    faults: Annotated[int, described("Sessions with each fault."), Range(at_least=1), OnlyWith("part", ("faults",))] = (
        20
    )
    models: Annotated[
        int, described("Sessions whose models are fitted."), Range(at_least=1), OnlyWith("part", ("models",))
    ] = 6
    resume: Annotated[
        bool,
        described("Keep the trials of benches that an earlier run of the same program left there.", flag=True),
    ] = False
    workers: Workers = None
    scheduler: Scheduler = None
    record: Annotated[Path | None, described("Folder in which simulated-lab-PARTS.md is kept, too.")] = None
    session: Annotated[
        Path | None, described("Also compare the calibration of this simulated session with the truth.")
    ] = None
    calibration: Annotated[Path, described("Folder of that session's calibration.")] = Path("out/calibrate")
    snr: Annotated[float, described("Signal-to-noise ratio of a white panel."), Range(above=0)] = 20.0
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/simulated-lab")


_DEFAULTS = SimulatedLabOptions()


def run(options: SimulatedLabOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Photograph, read and compare; writes simulated-lab.html, .md and .json.

    Raises:
        BadInputError: the session is not a simulated one, or cannot be calibrated.
    """
    folder = output_folder(options.out)
    tables: list[ReportTable] = []
    if "codes" in options.part:
        bench = design_photo_bench(load_device(_DEVICE), "right")
        trials = list(progress(code_trials(bench, options.snr, options.seed), 3, "codes"))
        tables = [code_table(trials, bench, options.snr)]
    if options.session is not None:
        truth = load_recipe(options.session).build()
        found = calibrated(CalibrateOptions(str(options.session), out=options.calibration), progress=progress)
        tables += truth_tables(compare_with_truth(truth, found, options.seed), options.seed)
    inputs = [] if options.session is None else [options.session]
    outcomes: list[BenchOutcome] = []
    tasks = bench_trials(options)
    try:
        for outcome in _outcomes(tasks, options, folder, progress):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda each: tasks.index(each.trial))
        record = {"seed": options.seed, "trials": outcomes}
        blocks = [*tables, *bench_tables(outcomes)]
        title = "Photographs compared with the truth"
        title += f": {len(outcomes)} of {len(tasks)} benches" if tasks else ""
        report = Report(title, blocks=blocks, inputs=inputs, record=record)
        report = save_report(report, folder, "simulated-lab")
        if options.record is not None:
            name = f"simulated-lab-{'-'.join(options.part)}.md"
            write_text(options.record / name, markdown(report, options.record))
    return report


def bench_trials(options: SimulatedLabOptions) -> list[BenchTrial]:
    """Trials of benches, mixed so that an interrupted study has some of each."""
    counts: dict[BenchTrialKind, int] = {}
    if "bench" in options.part:
        counts[BenchTrialKind.CLEAN] = options.benches
    if "faults" in options.part:
        counts |= dict.fromkeys(FAULTY, options.faults)
    if "models" in options.part:
        counts[BenchTrialKind.MODELS] = options.models
    trials = [BenchTrial(kind, number) for kind, count in counts.items() for number in range(count)]
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
        spread=options.spread,
    )
    return progress(finished, len(tasks), "benches")
