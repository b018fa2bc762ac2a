"""How good the reading of photographs is: codes at a low signal, and a whole session if one is given."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.photographs.codes import code_table, code_trials
from benchmarks.photographs.session_truth import compare_with_truth, truth_tables
from wlr_render.files import output_folder, write_text
from wlr_render.jobs.calibrate import photos as calibrate
from wlr_render.jobs.simulate.making import load_making
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT, Progress
from wlr_render.report.blocks import ReportTable, tables_as_json
from wlr_render.simulation.photographs.photo_bench import design_photo_bench

_DEVICE = "freeform40"  # its panel has 1920 x 1080 pixels


@dataclass(frozen=True)
class Options:
    """What to try.

    Attributes:
        session: folder of a simulated session, or None to try codes only.
        calibration: folder of what `calibrate` has read of it.
        snr: of a white panel.
        seed: of all random numbers.
        out: for the tables.
    """

    session: Path | None = None
    calibration: Path = Path("out/calibrate")
    snr: float = 20.0
    seed: int = 1
    out: Path = Path("out/benchmarks/photographs")


def run(options: Options, progress: Progress = SILENT) -> list[ReportTable]:
    """Photograph, read, compare; writes photographs.md and photographs.json.

    Raises:
        BadInputError: the session is not a simulated one, or cannot be calibrated.
    """
    folder = output_folder(options.out)
    bench = design_photo_bench(load_device(_DEVICE), "right")
    trials = list(progress(code_trials(bench, options.snr, options.seed), 3, "codes"))
    tables = [code_table(trials, bench, options.snr)]
    if options.session is not None:
        truth = load_making(options.session).build()
        found = calibrate.run(options.session, options.calibration, progress=progress)
        tables += truth_tables(compare_with_truth(truth, found, options.seed), options.seed)
    write_text(folder / "photographs.md", "\n".join(table.markdown() for table in tables))
    write_text(folder / "photographs.json", tables_as_json(tables, seed=options.seed))
    return tables
