"""Dense, noise-free captures: accuracy at equal degree, consistency along rays, size of the eye box."""

from collections.abc import Mapping

from wlr_render.jobs.evaluate.experiment import AnyTrial, Experiment, Findings, Key, Line, Plot, StudyOptions
from wlr_render.jobs.evaluate.trials import BACK_M, DisplayTrial, Measure, Outcome
from wlr_render.jobs.evaluate.world import EYE_BOX_MM
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, ReportTable

KINDS = ("planar", "volumetric")
DENSE = {"planar": 121, "volumetric": 125}
EYE_BOXES_MM = ((6.0, 4.0, 4.0), EYE_BOX_MM, (14.0, 10.0, 12.0))
_DEGREE = 5
_FIELD_VIEWPOINTS = {"planar": 25, "volumetric": 84}
_CLEARLY = 1.05  # smaller differences than 5 % are called none: the rms at random viewpoints is uncertain by about that


def dense_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, degree, kind."""
    return {
        (device, degree, kind): DisplayTrial(device, kind, degree, DENSE[kind])
        for device in options.devices
        for degree in options.degrees
        for kind in KINDS
    }


def dense_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """Equal degree, more captures than either model needs."""
    rows: list[list[Cell]] = []
    for device in options.devices:
        for degree in options.degrees:
            planar, volumetric = (outcomes[device, degree, kind] for kind in KINDS)
            ratio = volumetric.rms(Measure.FORWARD) / planar.rms(Measure.FORWARD)
            terms: list[Cell] = [term_count(4, degree), term_count(5, degree)]
            errors = [o.cell(m) for m in (Measure.FORWARD, Measure.BACKWARD) for o in (planar, volumetric)]
            rows.append([device, degree, *terms, *errors, ratio])
    columns = ["device", "N", *_per_kind("terms, {}"), *_per_kind("forward rms, {} (arcmin)")]
    columns += [*_per_kind("backward rms, {} (px)"), "forward, volumetric / planar"]
    title = f"Dense, noise-free, equal degree: {DENSE['planar']} planar and {DENSE['volumetric']} volumetric viewpoints"
    table = ReportTable(title, columns, rows, (_where_not_better(rows),))
    plot = _over_degree("error_over_degree", "Dense, noise-free captures", options, outcomes, Measure.FORWARD)
    return Findings((table,), (plot,))


def _where_not_better(rows: list[list[Cell]]) -> str:
    not_better = [row for row in rows if isinstance(row[-1], float) and row[-1] < _CLEARLY]
    places = ", ".join(f"{row[0]} N={row[1]} ({row[-1]:.2f})" for row in not_better)
    sentence = f"At equal degree planar is not clearly better in {len(not_better)} of {len(rows)} cases"
    return f"{sentence} (volumetric / planar below {_CLEARLY}){': ' + places if places else ''}."


def depth_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, degree, kind; the dense trials and degree 5."""
    again: dict[Key, AnyTrial] = {
        (device, _DEGREE, kind): DisplayTrial(device, kind, _DEGREE, DENSE[kind])
        for device in options.devices
        for kind in KINDS
    }
    return {**dense_cells(options), **again}


def depth_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """What a model says off the eye box on the very rays that it knows, and whether it contradicts itself there."""
    rows: list[list[Cell]] = []
    for device in options.devices:
        pair = [outcomes[device, _DEGREE, kind] for kind in KINDS]
        errors = [o.cell(m) for m in (Measure.FORWARD, Measure.MOVED_BACK) for o in pair]
        rows.append([device, *errors, *(o.errors[Measure.ALONG_RAY].p95 for o in pair)])
    columns = ["device", *_per_kind("in the eye box, {} (arcmin)"), *_per_kind("moved back, {} (arcmin)")]
    columns += _per_kind("self-contradiction p95, {} (arcmin)")
    title = f"Moved back {1e3 * BACK_M:g} mm along the same rays, N={_DEGREE}, dense captures"
    plot_title = f"Viewpoints moved back {1e3 * BACK_M:g} mm along their rays"
    plot = _over_degree("moved_back", plot_title, options, outcomes, Measure.MOVED_BACK)
    return Findings((ReportTable(title, columns, rows),), (plot,))


def _per_kind(column: str) -> list[str]:
    return [column.format(kind) for kind in KINDS]


def _over_degree(
    name: str, title: str, options: StudyOptions, outcomes: Mapping[Key, Outcome], measure: Measure
) -> Plot:
    lines = tuple(
        Line(f"{device}, {kind}", options.degrees, [outcomes[device, n, kind].rms(measure) for n in options.degrees])
        for device in options.devices
        for kind in KINDS
    )
    return Plot(name, title, "total degree N", "forward rms (arcmin)", lines)


def eye_box_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, eye box."""
    return {
        (device, box): DisplayTrial(device, "planar", _DEGREE, 25, eye_box_mm=box)
        for device in options.devices
        for box in EYE_BOXES_MM
    }


def eye_box_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """An error says little without its eye box."""
    names = [" x ".join(f"{edge:g}" for edge in box) + " mm" for box in EYE_BOXES_MM]
    rows = [[d, *(outcomes[d, box].cell(Measure.FORWARD) for box in EYE_BOXES_MM)] for d in options.devices]
    title = f"Size of the eye box: forward rms (arcmin), planar N={_DEGREE}, 25 viewpoints, noise-free"
    depths = [box[2] for box in EYE_BOXES_MM]
    lines = tuple(
        Line(device, depths, [outcomes[device, box].rms(Measure.FORWARD) for box in EYE_BOXES_MM])
        for device in options.devices
    )
    label = f"depth of the eye box (mm): {', '.join(names)}"
    plot = Plot("error_over_eye_box", f"Size of the eye box, planar N={_DEGREE}", label, "forward rms (arcmin)", lines)
    return Findings((ReportTable(title, ["device", *names], rows),), (plot,))


def field_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, whether the whole panel, kind."""
    return {
        (device, whole, kind): DisplayTrial(device, kind, _DEGREE, count, whole_panel=whole)
        for device in options.devices
        for whole in (False, True)
        for kind, count in _FIELD_VIEWPOINTS.items()
    }


def field_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """Nor does it say much without its field."""
    rows = [
        [device, *(outcomes[device, whole, kind].cell(Measure.FORWARD) for whole in (False, True) for kind in KINDS)]
        for device in options.devices
    ]
    columns = ["device", *_per_kind("nominal field, {} (arcmin)"), *_per_kind("whole panel, {} (arcmin)")]
    counts = " and ".join(f"{count} {kind}" for kind, count in _FIELD_VIEWPOINTS.items())
    return Findings((ReportTable(f"Size of the field: forward rms, N={_DEGREE}, {counts} viewpoints", columns, rows),))


DENSE_EXPERIMENT = Experiment("dense", dense_cells, dense_findings)
DEPTH_EXPERIMENT = Experiment("depth", depth_cells, depth_findings)
EYE_BOX_EXPERIMENT = Experiment("eye-box", eye_box_cells, eye_box_findings)
FIELD_EXPERIMENT = Experiment("field", field_cells, field_findings)
