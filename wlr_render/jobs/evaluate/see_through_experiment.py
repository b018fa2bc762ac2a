"""The world through the combiner: no model, a static one, planar and volumetric sampling."""

from collections.abc import Mapping
from itertools import product

from wlr_render.jobs.evaluate.experiment import (
    AnyTrial,
    Experiment,
    Findings,
    Key,
    StudyOptions,
    pooled,
    repetitions,
    spread_note,
)
from wlr_render.jobs.evaluate.trials import Measure, NoModelTrial, Outcome, SeeThroughTrial
from wlr_render.jobs.evaluate.world import FARTHEST_M, NEAREST_M
from wlr_render.report.blocks import Cell, ReportTable

MODELS = (("static", 3), ("volumetric", 3), ("planar", 3), ("planar", 5))
NOISES_ARCMIN = (0.0, 1.0)
_VIEWPOINTS = 25


def cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device; or device, kind, degree, noise, repetition."""
    without: dict[Key, AnyTrial] = {(device,): NoModelTrial(device) for device in options.devices}
    fitted: dict[Key, AnyTrial] = {
        (device, kind, degree, noise, repeat): SeeThroughTrial(
            device, kind, degree, _VIEWPOINTS, camera_noise_arcmin=noise, repeat=repeat
        )
        for device, (kind, degree), noise in product(options.devices, MODELS, NOISES_ARCMIN)
        for repeat in repetitions(options, noise)
    }
    return {**without, **fitted}


def findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """Errors of the direction of a real point, and of the real ray of a direction."""
    rows: list[list[Cell]] = []
    repeated: list[list[Outcome]] = []
    for device in options.devices:
        rows.append([device, "none", None, outcomes[(device,)].cell(Measure.REAL_POINT), None, None, None])
        for kind, degree in MODELS:
            exact, noisy = (
                [outcomes[device, kind, degree, s, k] for k in repetitions(options, s)] for s in NOISES_ARCMIN
            )
            measures = (Measure.REAL_RAY, Measure.MISS)
            errors = [pooled(exact, Measure.REAL_POINT), pooled(noisy, Measure.REAL_POINT)]
            rows.append([device, kind, degree, *errors, *(pooled(noisy, measure) for measure in measures)])
            repeated.append(noisy)
    columns = ["device", "model", "N", "real point, exact (arcmin)", "real point, 1' noise (arcmin)"]
    columns += ["real ray, 1' noise (arcmin)", "its miss, 1' noise (mm)"]
    where = f"rms over real points at {NEAREST_M:g} to {FARTHEST_M:g} m"
    title = f"See-through: {where}, {_VIEWPOINTS} viewpoints (static: one)"
    note = spread_note(repeated, Measure.REAL_POINT)
    return Findings((ReportTable(title, columns, rows, (note,)),))


SEE_THROUGH_EXPERIMENT = Experiment("see-through", cells, findings)
