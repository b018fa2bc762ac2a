"""Tables of the evidence for display models from captures at two viewpoints."""

from collections.abc import Sequence

import numpy as np

from benchmarks.published_data.viewpoint_evidence import EyeEvidence, MirrorSplit, ViewpointEvidence, rms, vector_rms
from wlr_render.report.blocks import Cell, ReportTable


def tables(evidence: ViewpointEvidence) -> tuple[ReportTable, ...]:
    """Tabulate the models by their held-out error, the misclosure of rays, and the residual of the bundle."""
    eyes, split = evidence.eyes, evidence.split
    return (_model_table(eyes), _misclosure_table(eyes, split), _rest_table(eyes, split))


def verdict(evidence: ViewpointEvidence) -> str:
    """State the most probable model of each eye, and the rig's share in the misclosure of rays."""
    best = {eye.eye: max(eye.models, key=lambda model: model.log_evidence) for eye in evidence.eyes}
    sentence = " ".join(
        f"{eye.capitalize()} eye: {model.name}, wrong by {model.held_out_arcmin:.2f}' in held-out cells."
        for eye, model in best.items()
    )
    split = evidence.split
    if split is None:
        return sentence
    sigma, share = _split_sigma(evidence.eyes), split.rig_arcmin**2 / (split.rig_arcmin**2 + split.optics_arcmin**2)
    return (
        f"{sentence} The two rays of a pixel miss each other by {np.hypot(split.rig_arcmin, split.optics_arcmin):.1f}' "
        f"rms: {split.optics_arcmin:.1f}' are the optics' and {split.rig_arcmin:.1f}' +- {sigma:.1f}' the rig's, "
        f"{100 * share:.2g} % of the mean square."
    )


def _split_sigma(eyes: Sequence[EyeEvidence]) -> float:
    """Return the uncertainty of the misclosure's parts, arcminutes."""
    return 0.5 * float(np.linalg.norm([eye.misclosure_sigma_arcmin for eye in eyes]))


def _model_table(eyes: Sequence[EyeEvidence]) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            eye.eye,
            model.name,
            model.polynomials,
            model.log_evidence,
            model.held_out_arcmin,
            model.standard_error,
            model.held_out_arcmin / eye.noise_arcmin,
        ]
        for eye in eyes
        for model in eye.models
    ]
    columns = ["eye", "model", "polynomials", "log evidence", "held out (arcmin)", "+-", "over noise"]
    noise = "; ".join(
        f"{eye.eye}: {eye.rows} rows, viewpoints {eye.baseline_m * 1e3:.1f} mm apart, noise {eye.noise_arcmin:.2f}'"
        for eye in eyes
    )
    notes = (
        f"Rms angle in cells of the panel that were not fitted. {noise}.",
        "Two viewpoints cannot test that a bundle's directions stay the same along their rays.",
    )
    return ReportTable("Which model the captures support", columns, rows, notes)


def _misclosure_table(eyes: Sequence[EyeEvidence], split: MirrorSplit | None) -> ReportTable:
    rows: list[list[Cell]] = []
    for eye in eyes:
        near, middle, far = (float(d) for d in np.percentile(eye.image_dioptre, [95, 50, 5]))
        misclosure = rms(eye.misclosure_arcmin)
        rows.append([f"{eye.eye} eye", misclosure, eye.misclosure_sigma_arcmin, middle, far, near])
    if split is not None:
        sigma = _split_sigma(eyes)
        rows.append(["optics (opposite in mirrored pixels)", split.optics_arcmin, sigma, None, None, None])
        rows.append(["rig (equal in mirrored pixels)", split.rig_arcmin, sigma, None, None, None])
    columns = ["part", "misclosure rms (arcmin)", "+-", "image (1/m), median", "5 %", "95 %"]
    notes = (
        "Misclosure: the angle by which the two rays of a pixel pass each other; zero for one 3-D point per pixel.",
    )
    return ReportTable("Whether the two rays of a pixel meet", columns, rows, notes)


def _rest_table(eyes: Sequence[EyeEvidence], split: MirrorSplit | None) -> ReportTable:
    rows: list[list[Cell]] = [[f"{eye.eye} eye", *map(float, vector_rms(eye.rest_arcmin))] for eye in eyes]
    if split is not None:
        rows.append(["with the optics' symmetry", *map(float, split.optics_rest_arcmin)])
        rows.append(["against it (rig)", *map(float, split.rig_rest_arcmin)])
    columns = ["part", "first viewpoint (arcmin)", "second viewpoint (arcmin)"]
    notes = (
        "Rms of the mean residual in cells of the panel, all of them fitted; noise is averaged down within a cell.",
        "A lens error of both cameras has the optics' symmetry too.",
    )
    return ReportTable("What the bundle of rays leaves", columns, rows, notes)
