"""The report of a diagnosis: verdict and advice first, then the evidence as text, tables and plots."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wlr_render.bench.session_folder import remove_session, save_session
from wlr_render.diagnosis import diagnosis_plots as plots
from wlr_render.diagnosis import tables, verdict_sentences
from wlr_render.diagnosis.diagnosis import DiagnosisRecord, FoundCause, ResidualSummary
from wlr_render.diagnosis.improvement import ImprovementInUse, improvement_in_use
from wlr_render.diagnosis.report_warnings import warnings
from wlr_render.diagnosis.residual_views import PartView, part_views
from wlr_render.diagnosis.verdict_sentences import bench_sentence
from wlr_render.html_summary import html_summary
from wlr_render.io.atomic_files import output_folder
from wlr_render.report.blocks import Block, Plot, Report, ReportTable, Section, Text, capitalised
from wlr_render.report.records import fields_of
from wlr_render.report.save import save_report

CORRECTED = "corrected"
"""Folder of the corrected session, in the folder of the report."""
STEM = "diagnosis"
"""Start of the names of the report's files."""


@dataclass(frozen=True, eq=False)
class Diagnosis(DiagnosisRecord):
    """The result of `diagnose`: its record, advice, and report; attributes as in `DiagnosisRecord`.

    `print` shows the verdict and the next steps; notebooks show tables.
    """

    def save(self, folder: str | Path) -> list[Path]:
        """Write diagnosis.html, .md and .json and, if the bench was corrected, the session folder `corrected`.

        Returns:
            The files of the report, and the folder of the corrected session.

        Raises:
            BadInputError: the folder cannot be written, or its `corrected` is something other than a session.
        """
        folder = output_folder(folder)
        files = write_corrected(folder / CORRECTED, self)
        report = diagnosis_report(self, improvement_found(self), folder=folder)
        return list(save_report(replace(report, files=files), folder, STEM).files)

    @property
    def advice(self) -> list[str]:
        """Next steps as sentences, most urgent first."""
        return verdict_sentences.advice(self)

    @property
    def values_to_type(self) -> list[str]:
        """Lines that make bench.toml describe the corrected bench, except its device."""
        return verdict_sentences.values_to_type(self)

    @property
    def residual_views(self) -> list[PartView]:
        """Residuals of each part of the session against each variable, as the report plots them."""
        return part_views(self)

    def __str__(self) -> str:
        sentence = verdict_sentences.verdict_sentence(self)
        return "\n".join([sentence, *(f"{n}. {step}" for n, step in enumerate(self.advice, 1))])

    def _repr_html_(self) -> str:
        shown = [each.summary for each in (tables.residuals_table(self), tables.causes_table(self)) if each.rows]
        return html_summary(self.title, str(self).splitlines(), shown)


def diagnosis_record(diagnosis: DiagnosisRecord, in_use: ImprovementInUse | None = None) -> dict[str, Any]:
    """Return the record for the JSON file.

    Users' scripts read these keys, so they must not change: `verdict`, `causes` (`name`, `parameters` by name,
    `held_out_gain`, `gain_sigma`, `overlaps_with`), `outliers`, `before` and `after` (`display_rms_px`,
    `seethrough_rms_arcmin`, `runtime_rms_arcmin` and their noise floors), `unexplained` (`part`, `excess`,
    `rms_over_noise`), `effects` (`station`, `coordinates`, `form`, `log10_odds`, `size`, `likely`).
    """
    left = diagnosis.unexplained_parts
    return {
        **fields_of(diagnosis),
        "causes": [_cause_record(cause) for cause in diagnosis.causes],
        "outliers": [moved.capture.capture for moved in diagnosis.excluded],
        "before": _residual_record(diagnosis.before, diagnosis.noise),
        "after": _residual_record(diagnosis.after, diagnosis.noise),
        "unexplained": left[0] if left else None,
        "in_use": in_use,
    }


def _cause_record(cause: FoundCause) -> dict[str, Any]:
    return {
        **fields_of(cause),
        "parameters": {parameter.name: parameter for parameter in cause.parameters},
        "held_out_gain": cause.improvement.percent,
        "gain_sigma": cause.improvement.sigma,
        "overlaps_with": [other.name for other in cause.degenerate],
    }


def _residual_record(residual: ResidualSummary, noise: ResidualSummary) -> dict[str, float | None]:
    return {
        "display_rms_px": residual.display_rms_px,
        "display_noise_floor_px": noise.display_rms_px,
        "seethrough_rms_arcmin": residual.see_through_rms_arcmin,
        "seethrough_noise_floor_arcmin": noise.see_through_rms_arcmin,
        "runtime_rms_arcmin": residual.run_time_rms_arcmin,
        "runtime_noise_floor_arcmin": noise.run_time_rms_arcmin,
        "rms_over_noise": residual.over_noise,
    }


def diagnosis_report(
    diagnosis: DiagnosisRecord,
    in_use: ImprovementInUse | None = None,
    inputs: tuple[Path, ...] = (),
    folder: Path = Path(),
    add_causes: Sequence[str] = (),
) -> Report:
    """Return the report of a diagnosis.

    Args:
        diagnosis: the record.
        in_use: improvement in use, if causes were found.
        inputs: files and folders that were read.
        folder: output folder; it contains the corrected session as `CORRECTED`.
        add_causes: files and modules with the user's causes, for the commands that the report suggests.
    """
    blocks: list[Block] = [Section("Result"), tables.residuals_table(diagnosis), tables.causes_table(diagnosis)]
    lines = verdict_sentences.values_to_type(diagnosis)
    note = f"Values to enter in bench.toml, as in the corrected bench. {verdict_sentences.FRAME_NOTE}"
    blocks += [Text(note, lines)] if lines else []
    blocks += [*_next_steps(diagnosis, folder, add_causes), tables.limits_table(diagnosis)]
    if diagnosis.effects:
        blocks += [Section("Effects"), tables.effects_table(diagnosis)]
        blocks += [plots.effect_map(effect) for effect in diagnosis.effects]
    for part in part_views(diagnosis):
        blocks += [
            Section(f"{capitalised(part.name)} residual"),
            plots.residual_maps(part),
            plots.residual_curves(part),
        ]
    blocks += [Section("Captures"), _captures(diagnosis), tables.excluded_table(diagnosis)]
    blocks += [tables.captures_table(diagnosis), Section("Evidence")]
    blocks += [tables.in_use_table(in_use)] if in_use else []
    blocks += [tables.parameters_table(diagnosis), tables.ranking_table(diagnosis)]
    blocks += [plots.correlations_plot(diagnosis)] if len(diagnosis.correlations.names) > 1 else []
    blocks += [tables.fields_table(diagnosis), Text("Why the search ended:", diagnosis.reasons)]
    blocks += [Section("Noise"), tables.repeatability_table(diagnosis), tables.noise_table(diagnosis)]
    blocks += [plots.normality_plot(diagnosis)]
    return Report(
        diagnosis.title,
        f"{verdict_sentences.verdict_sentence(diagnosis)} {bench_sentence(diagnosis)}",
        verdict_sentences.advice(diagnosis),
        warnings(diagnosis),
        [block for block in blocks if not isinstance(block, ReportTable) or block.rows],
        inputs,
        record=diagnosis_record(diagnosis, in_use),
    )


def _captures(diagnosis: DiagnosisRecord) -> Plot:
    rms = {"bench as described": [each.rms_before for each in diagnosis.captures]}
    if diagnosis.is_corrected:
        rms["corrected bench"] = [each.rms_after for each in diagnosis.captures]
    caption = "1 is the noise alone; the motion of each capture adds to it. Crosses: excluded captures."
    excluded = [each.excluded for each in diagnosis.captures]
    return plots.captures_plot([each.capture for each in diagnosis.captures], rms, caption, excluded)


def _next_steps(diagnosis: DiagnosisRecord, folder: Path, add_causes: Sequence[str]) -> list[Block]:
    """Return commands to continue with the corrected session, for the working directory of this run."""
    if not diagnosis.is_corrected:
        return []
    plan = diagnosis.observations.session.plan
    corrected = folder / CORRECTED
    added = ["--add-causes", *add_causes] if add_causes else []
    commands = [["diagnose", str(corrected), "--out", str(folder / "again"), *added]]
    if plan.display is not None and plan.see_through is not None:
        commands.append(["calibrate", str(corrected)])
    if diagnosis.corrected.device is not diagnosis.observations.nominal.device:
        commands.append(["render", str(corrected / "device.toml"), "desk"])
    text = (
        f"The folder {corrected} is a session: the readings that were used, and the corrected bench. Check that it "
        "predicts the readings, and use it:"
    )
    return [Text(text, [f"wlr-render {shlex.join(command)}" for command in commands])]


def improvement_found(diagnosis: DiagnosisRecord) -> ImprovementInUse | None:
    """Return the improvement in use on the readings that were used; None without causes."""
    if not diagnosis.causes:
        return None
    session = diagnosis.observations.of_rows(diagnosis.used).session
    return improvement_in_use(diagnosis.observations.nominal, diagnosis.corrected, session)


def write_corrected(folder: Path, diagnosis: DiagnosisRecord) -> list[Path]:
    """Write the corrected bench and the used readings as a session, replacing the session of an earlier diagnosis."""
    if folder.is_dir():
        remove_session(folder)
    if not diagnosis.is_corrected:
        return []
    # Drop the priors of these causes: the corrected bench now includes their values.
    names = {cause.name for cause in diagnosis.causes}
    priors = {name: stated for name, stated in diagnosis.corrected.priors.items() if name not in names}
    corrected = replace(diagnosis.corrected, priors=priors)
    return [save_session(folder, corrected, diagnosis.observations.of_rows(diagnosis.used).session)]
