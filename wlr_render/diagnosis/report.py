"""The report of a diagnosis: verdict and advice first, then the evidence as text, tables and plots."""

from dataclasses import dataclass
from pathlib import Path

from wlr_render.diagnosis import explain, plots, tables
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.improvement import ImprovementInUse
from wlr_render.diagnosis.residual_views import part_views
from wlr_render.report.blocks import Block, Report, ReportTable, Section, Text

CORRECTED = "corrected"
"""Folder of the corrected session, beside the report."""


@dataclass(frozen=True, eq=False)
class DiagnosisRecord:
    """What the JSON file holds beside the tables."""

    diagnosis: Diagnosis
    in_use: ImprovementInUse | None


def diagnosis_report(
    diagnosis: Diagnosis, in_use: ImprovementInUse | None = None, inputs: tuple[Path, ...] = ()
) -> Report:
    """Build the report."""
    blocks: list[Block] = [Section("Result"), tables.residuals_table(diagnosis), tables.causes_table(diagnosis)]
    blocks += [*_values(diagnosis), *_next_steps(diagnosis), tables.limits_table(diagnosis)]
    for part in part_views(diagnosis):
        name = part.name[:1].upper() + part.name[1:]
        blocks += [Section(f"{name} residual"), plots.residual_maps(part), plots.residual_curves(part)]
    blocks += [Section("Captures"), plots.captures_plot(diagnosis), tables.excluded_table(diagnosis)]
    blocks += [tables.captures_table(diagnosis), Section("Evidence")]
    blocks += [tables.in_use_table(in_use)] if in_use else []
    blocks += [tables.parameters_table(diagnosis), tables.ranking_table(diagnosis), tables.degenerate_table(diagnosis)]
    blocks += [plots.correlations_plot(diagnosis)] if len(diagnosis.correlations.names) > 1 else []
    blocks += [tables.unexplained_table(diagnosis), Text("Why the search ended:", diagnosis.reasons)]
    blocks += [Section("Noise"), tables.noise_table(diagnosis), plots.normality_plot(diagnosis)]
    return Report(
        f"Diagnosis of {diagnosis.session} ({diagnosis.device}, {diagnosis.eye} eye)",
        explain.verdict_sentence(diagnosis),
        explain.advice(diagnosis),
        explain.warnings(diagnosis),
        [block for block in blocks if not isinstance(block, ReportTable) or block.rows],
        inputs,
        record=DiagnosisRecord(diagnosis, in_use),
    )


def _values(diagnosis: Diagnosis) -> list[Block]:
    lines = explain.values_to_type(diagnosis)
    return (
        [Text(f"Values for bench.toml, as the corrected bench has them. {explain.FRAME_NOTE}", lines)] if lines else []
    )


def _next_steps(diagnosis: Diagnosis) -> list[Block]:
    """Commands to go on with the corrected session."""
    if not diagnosis.causes:
        return []
    plan = diagnosis.observations.session.plan
    verbs = [f"diagnose {CORRECTED} --out again"]
    if plan.display is not None and plan.see_through is not None:
        verbs.append(f"calibrate captures {CORRECTED}")
    if diagnosis.corrected.device is not diagnosis.observations.nominal.device:
        verbs.append(f"render {CORRECTED}/device.toml desk")
    text = (
        f"The folder {CORRECTED}, beside this report, is a session: the readings that were used, and the bench with "
        "the causes at work. Check that it predicts the readings, and use it:"
    )
    return [Text(text, [f"wlr-render {verb}" for verb in verbs])]
