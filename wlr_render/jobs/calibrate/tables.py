"""A calibration from photographs in tables: what was read, how sure the station is, and how well the models fit."""

from collections import Counter

import numpy as np

from wlr_render.calibration.camera_calibration import VALUES
from wlr_render.calibration.fit_report import FitReport
from wlr_render.calibration.regression import FOLDS
from wlr_render.captures.decoded import Rejection
from wlr_render.jobs.calibrate.captures import fit_tables
from wlr_render.jobs.calibrate.photos import Lens, SessionCalibration
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, ReportTable, cell_text

_LIMITED_BY_MODEL = 3.0  # times the noise: a larger held-out error is the model's


def headline(found: SessionCalibration) -> str:
    """One sentence: what was read, what came of it, and whether anything is off."""
    off = [check for check in found.station.checks if not check.ok]
    fit = found.fit
    warned = (
        f"{len(off)} check(s) of the station say that something is off"
        if off
        else "every check of the station is right"
    )
    return (
        f"{len(found.reading.boards)} photographs of the board and {len(found.reading.panels)} sets of the panel read, "
        f"{len(found.left_out)} set aside; display N={fit.display.degree} fits to "
        f"{fit.display.residual_arcmin.rms:.2f}' rms, see-through N={fit.see_through.degree} to "
        f"{fit.see_through.residual_arcmin.rms:.2f}'; {warned}."
    )


def session_tables(found: SessionCalibration) -> tuple[ReportTable, ...]:
    """All tables, in the order of the procedure."""
    tables = [
        _read_table(found),
        _set_aside_table(found),
        _decoded_table(found),
        _lens_table(found),
        _poses_table(found),
    ]
    return (
        *(table for table in tables if table.rows),
        _checks_table(found),
        *fit_tables(found.fit),
        _choice_table(found),
    )


def _read_table(found: SessionCalibration) -> ReportTable:
    session, reading = found.session, found.reading
    rows: list[list[Cell]] = []
    for name, photographs in (
        ("target without the headset", session.bare),
        ("target by the tracking camera", session.tracking),
        ("target through the optics", session.see_through),
    ):
        dots = [len(observation) for _, observation in reading.seen(photographs)]
        sigma = [float(np.median(observation.sigma_px)) for _, observation in reading.seen(photographs)]
        rows.append([name, len(photographs), len(dots), sum(dots), float(np.median(sigma)) if sigma else None])
    samples = [each.samples for _, each in reading.decoded(session.display)]
    sigma_px = float(np.median(np.concatenate([each.sigma_px for each in samples]))) if samples else None
    rows.append(["panel", len(session.display), len(samples), sum(len(each) for each in samples), sigma_px])
    columns = ["photographs of", "given", "read", "dots or samples", "noise of one (px)"]
    notes = (
        "Dots: camera pixels. Samples of the panel: panel pixels, each the mean of a window of camera pixels.",
        "Dots beyond the panel's field, and dots that lie beside their place, are not fitted.",
    )
    return ReportTable("What was read", columns, rows, notes)


def _set_aside_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = [[name, reason] for name, reason in found.left_out]
    return ReportTable("Set aside", ["photograph", "reason"], rows)


def _decoded_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for each, panel in found.reading.decoded(found.session.display):
        share = panel.counts / panel.counts.sum()
        low, high = panel.extent
        covered = float(np.prod((high - low) / found.session.pattern.panel.size_px))
        rejected: Counter[str] = Counter(
            {
                reason.name.lower().replace("_", " "): float(share[reason])
                for reason in Rejection
                if reason > Rejection.DARK
            }
        )
        most = [f"{name} {100 * part:.2g} %" for name, part in rejected.most_common(2) if part > 0]
        name = found.session.name_of(each.folder)
        rows.append([name, 100 * float(share[0]), 100 * covered, len(panel.samples), ", ".join(most) or "-"])
    columns = ["set", "decoded (% of picture)", "panel's box seen (%)", "samples", "most rejected, but for dark"]
    return ReportTable("Decoded sets", columns, rows)


def _lens_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, lens in (("eyeball camera", found.eyeball), ("tracking camera", found.tracking)):
        rows += _lens_rows(name, lens)
    notes = ("Focal length and centre in pixels, the centre from the outer corner of the top-left pixel.",)
    return ReportTable("Lenses", ["camera", "value", "found", "standard deviation"], rows, notes)


def _lens_rows(name: str, lens: Lens) -> list[list[Cell]]:
    camera, found = lens.camera, lens.calibration
    values = np.concatenate([camera.focal_px, camera.centre_px, camera.distortion])
    sigma = [None] * len(values) if found is None else [float(one) for one in found.sigma]
    rows: list[list[Cell]] = [
        [name, value, f"{number:.6g}", one]
        for value, number, one in zip(VALUES, values, sigma, strict=True)
        if number != 0
    ]
    error = float(np.sqrt(np.mean(lens.poses.rms_px**2)))
    return [*rows, [name, "reprojection error, rms (px)", f"{error:.3g}", None]]


def _poses_table(found: SessionCalibration) -> ReportTable:
    station = found.station
    poses = {"eyeball camera, at the reference reading": station.pose_at(station.stage.reference)}
    poses |= {f"target pose {number}": pose for number, pose in station.device_from_target.items()}
    rows: list[list[Cell]] = []
    for name, pose in poses.items():
        place = ", ".join(f"{1e3 * length:.3f}" for length in pose.b_from_a[:3, 3])
        turn, shift = (" / ".join(f"{one:.2g}" for one in sigma) for sigma in (pose.sigma_arcmin, pose.sigma_mm))
        rows.append([name, place, shift, turn])
    columns = ["pose", "origin (mm)", "its sigma x / y / z (mm)", "sigma of rotation about x / y / z (arcmin)"]
    jitter = station.stage.jitter
    notes = (
        "Device frame with OpenXR's axes (x right, y up, z backward), whatever axes session.toml has.",
        f"Repeatability of the stage: {1e6 * jitter.translation_m:.2g} um and {1e6 * jitter.rotation_rad:.2g} "
        "microradians per axis; the eyeball camera's sigmas include it.",
    )
    return ReportTable("Poses in the device frame", columns, rows, notes)


def _checks_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            "right" if check.ok else "OFF",
            check.step,
            check.quantity,
            float(check.value),
            float(check.limit),
            check.sentence,
        ]
        for check in sorted(found.station.checks, key=lambda check: check.ok)
    ]
    columns = ["", "step", "quantity", "value", "limit", "what it says"]
    return ReportTable("Checks of the station", columns, rows, tuple(found.station.unchecked))


def _choice_table(found: SessionCalibration) -> ReportTable:
    see_through = found.captures.see_through
    assert see_through is not None
    rows: list[list[Cell]] = [
        [name, report.degree, _why(report), _what_would_help(report, np.sqrt(2.0) * float(np.median(sigma)))]
        for name, report, sigma in (
            ("display", found.fit.display, found.captures.display.sigma_arcmin),
            ("see-through", found.fit.see_through, see_through.sigma_arcmin),
        )
    ]
    return ReportTable("Why these degrees", ["mapping", "N", "because", "what would help"], rows)


def _why(report: FitReport) -> str:
    tried = {entry.degree: entry for entry in report.held_out_arcmin}
    if len(tried) < 2 or report.degree not in tried:
        return "no other was tried"
    chosen, best = tried[report.degree], min(tried.values(), key=lambda entry: entry.rms)
    beyond = [entry for entry in tried.values() if entry.degree > report.degree]
    if chosen is best:
        worse = f"; N={beyond[0].degree} does worse ({cell_text(beyond[0].rms)}')" if beyond else ""
        return f"it predicts held-out camera positions best ({cell_text(chosen.rms)}'){worse}"
    return (
        f"it predicts held-out camera positions to {cell_text(chosen.rms)}', as well as the best, N={best.degree}, "
        f"within its error ({cell_text(best.rms)}' +- {best.standard_error:.2g}')"
    )


def _what_would_help(report: FitReport, noise_arcmin: float) -> str:
    """Whether the model or the noise is what limits it, and how many camera places a better model needs."""
    held_out = report.held_out_at_degree()
    if report.kind != "planar" or held_out is None or held_out.rms < _LIMITED_BY_MODEL * noise_arcmin:
        return "-"
    needed = term_count(2, report.degree + 1)
    places = int(np.ceil(needed * FOLDS / (FOLDS - 1))) + 1  # so that enough are left when some are held out
    if report.viewpoints >= places:
        return (
            f"noise is {cell_text(noise_arcmin)}', so the model is what limits it: photograph from more camera places"
        )
    return (
        f"noise is {cell_text(noise_arcmin)}', so the model's degree is what limits it: N={report.degree + 1} needs "
        f"{places} camera places or more, here are {report.viewpoints}"
    )
