"""Repeatability and noise of a diagnosis as tables."""

import numpy as np

from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.noise_sentences import both_parts, undetermined_parts, with_error
from wlr_render.report.blocks import Cell, ReportTable

_BOTH = "both, weighted mean"


def repeatability_table(diagnosis: Diagnosis) -> ReportTable:
    """Repeatability of the captures of each part, and of both together where the parts agree."""
    unknown, both = undetermined_parts(diagnosis), both_parts(diagnosis)
    motions = [
        (f"{each.part} (not determined)" if each.part in unknown else each.part, each) for each in diagnosis.motions
    ]
    motions += [(_BOTH, both[1])] if both else []
    rows: list[list[Cell]] = [
        [name, with_error(each.shift_um, each.shift_error_um), with_error(each.turn_urad, each.turn_error_urad)]
        for name, each in motions
    ]
    columns = ("part", "positions (um)", "turns (urad)")
    notes = ["Standard deviation, per axis, of the random motion of the camera against the headset in each capture."]
    if unknown:
        notes.append("Not determined: no cause explains the residual, and the motions contain it.")
    return ReportTable("Repeatability", columns, rows, notes)


def noise_table(diagnosis: Diagnosis) -> ReportTable:
    """Noise of each part: stated, measured, and used."""
    rows: list[list[Cell]] = [
        [
            floor.part,
            floor.stated_px,
            floor.within_px,
            floor.repeats_px,
            with_error(floor.measured_px, floor.error_px),
            floor.used_px,
            "yes" if floor.is_believable else "no",
            floor.rim_factor,
            100 * float(np.expm1(floor.photographs_differ)),
            100 * floor.shared,
        ]
        for floor in diagnosis.noise_floors
    ]
    both = both_parts(diagnosis)
    if both is not None:
        rows.append([_BOTH, None, None, None, with_error(both[0].measured_px, both[0].error_px), *[None] * 5])
    columns = (
        "noise (camera px)",
        "stated",
        "within photographs",
        "repeats",
        "measured",
        "used",
        "stated agrees",
        "corner / middle",
        "photographs differ (%)",
        "shared (%)",
    )
    note = (
        "Within photographs: residual of a smooth surface fitted to each photograph. Repeats: photographs taken twice "
        "from one place. Measured: both combined by inverse variance. Used: measured and stated weighted by their "
        "errors, or the measured one where the stated one does not agree. Shared: of the variance, by neighbouring "
        "points of a photograph."
    )
    return ReportTable("Noise", columns, rows, (note,))
