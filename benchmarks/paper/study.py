"""Planar against volumetric sampling in simulation, as in the paper."""

from dataclasses import KW_ONLY, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from benchmarks.paper.experiments import DISPLAY, SEE_THROUGH, dense, depth, eye_box, field, positions, structure
from wlr_render.jobs.evaluate.study import Experiment, StudyOptions, run_study
from wlr_render.jobs.options import Degree, ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report


@dataclass(frozen=True)
class PaperOptions(StudyOptions):
    """Options of `paper`."""

    _: KW_ONLY
    degrees: Annotated[tuple[int, ...], described("Total degrees of the models.", many=True), Degree] = (
        3,
        4,
        5,
    )
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/paper")


def run(options: PaperOptions = PaperOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Run the experiments; writes paper.html, .md and .json.

    Raises:
        BadInputError: see `run_study`.
    """
    experiments: dict[str, Experiment] = {
        "display-dense": partial(dense, DISPLAY, options.degrees),
        "display-depth": partial(depth, DISPLAY, options.degrees),
        "display-camera-positions": partial(positions, DISPLAY),
        "see-through-dense": partial(dense, SEE_THROUGH, options.degrees),
        "see-through-depth": partial(depth, SEE_THROUGH, options.degrees),
        "see-through-camera-positions": partial(positions, SEE_THROUGH),
        "structure": structure,
        "eye-box": eye_box,
        "field": field,
    }
    return run_study("Planar against volumetric sampling", options, experiments, "paper", progress)
