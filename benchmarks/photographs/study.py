"""Accuracy of reading photographs: codes at low signal, and a whole session if one is given."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from benchmarks.photographs.codes import code_table, code_trials
from benchmarks.photographs.session_truth import compare_with_truth, truth_tables
from wlr_render.files import output_folder
from wlr_render.jobs.calibrate.photos import CalibratePhotosOptions, calibrated
from wlr_render.jobs.options import Options, ProgressArgument, Range, Seed, described
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.simulation.photographs.photo_bench import design_photo_bench
from wlr_render.simulation.photographs.recipe import load_recipe

_DEVICE = "freeform40"  # its panel has 1920 x 1080 pixels


@dataclass(frozen=True)
class PhotographsOptions(Options):
    """Options of `photographs`."""

    _: KW_ONLY
    session: Annotated[
        Path | None, described("Also compare the calibration of this simulated session with the truth.")
    ] = None
    calibration: Annotated[Path, described("Folder of that session's calibration.")] = Path("out/calibrate")
    snr: Annotated[float, described("Signal-to-noise ratio of a white panel."), Range(above=0)] = 20.0
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/photographs")


_DEFAULTS = PhotographsOptions()


def run(options: PhotographsOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Photograph, read, compare; writes photographs.html, .md and .json.

    Raises:
        BadInputError: the session is not a simulated one, or cannot be calibrated.
    """
    folder = output_folder(options.out)
    bench = design_photo_bench(load_device(_DEVICE), "right")
    trials = list(progress(code_trials(bench, options.snr, options.seed), 3, "codes"))
    tables = [code_table(trials, bench, options.snr)]
    if options.session is not None:
        truth = load_recipe(options.session).build()
        found = calibrated(CalibratePhotosOptions(options.session, out=options.calibration), progress=progress)
        tables += truth_tables(compare_with_truth(truth, found, options.seed), options.seed)
    inputs = [] if options.session is None else [options.session]
    report = Report("Photographs compared with the truth", blocks=tables, inputs=inputs, record={"seed": options.seed})
    return save_report(report, folder, "photographs")
