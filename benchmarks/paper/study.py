"""Planar against volumetric sampling in simulation: the claim of the paper's sections 3.3 and 3.4."""

from dataclasses import KW_ONLY, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from benchmarks.paper.experiments import (
    DISPLAY,
    SEE_THROUGH,
    dense,
    depth,
    eye_box,
    field,
    see_through_positions,
    structure,
)
from benchmarks.paper.failure_figures import failures
from benchmarks.paper.figures import (
    display_bundle,
    one_pixel,
    pupil_swim,
    sampling,
    see_through_bundle,
    two_planes,
)
from benchmarks.trial_study import Experiment, Findings, Study, StudyOptions, run_study
from wlr_render.jobs.options import Degree, ProgressArgument, described
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT


def figures(study: Study) -> Findings:
    """Draw the paper's figures in its order: some for the first eye, pupil swim and failures for all eyes."""
    eye, eyes = study.eyes[0], tuple(study.eyes)
    swim, display_swim, see_through_swim = pupil_swim(eyes)
    bundles = display_bundle(eye), see_through_bundle(eye)
    blocks = (one_pixel(eye), swim, display_swim, sampling(eye), *failures(eyes), *bundles, see_through_swim)
    return Findings((*blocks, two_planes(eye)))


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
    """Run the experiments; write paper.html, .md and .json.

    Raises:
        BadInputError: see `run_study`.
    """
    experiments: dict[str, Experiment] = {
        "display-dense": partial(dense, DISPLAY, options.degrees),
        "display-depth": partial(depth, DISPLAY, options.degrees),
        "see-through-dense": partial(dense, SEE_THROUGH, options.degrees),
        "see-through-depth": partial(depth, SEE_THROUGH, options.degrees),
        "see-through-camera-positions": see_through_positions,
        "structure": structure,
        "figures": figures,
        "eye-box": eye_box,
        "field": field,
    }
    return run_study("Planar against volumetric sampling", options, experiments, "paper", progress)
