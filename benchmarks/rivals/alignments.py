"""SPAAM, INDICA and fitted displays on alignments that a wearer made, with tracked eyes.

Display and see-through are not separated: in an alignment the pixel covers the marker for this eye, through the optics.
So all methods are judged for display and see-through together, and ours are fitted as displays with straight
see-through rays.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.published_data.itoh_alignments import Alignments, Screen, Sitting
from benchmarks.rivals.displays import DISPLAYS
from benchmarks.rivals.held_out import COLUMNS, HeldOut, cells, held_out, remark, rms_of
from benchmarks.rivals.pinhole import fit_projection
from benchmarks.rivals.pinhole_models import PinholeDisplay
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.mappings import DisplayMapping, EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.report.blocks import Cell, ReportTable

_FREE = 11  # free parameters of SPAAM
_LEAST_SIZE = 1e-3  # smallest size of the eye box, metres
REFERENCE = "SPAAM of another sitting"

Predict = Callable[[FloatArray, FloatArray], FloatArray]
"""Function of points (n, 3) and eye (3,) that returns pixels (n, 2)."""


def alignment_tables(found: Alignments) -> list[ReportTable]:
    """Tabulate errors of all methods on alignments that were not fitted, and a wearer's repeatability."""
    judged = _judged(found)
    reference = next(each for each in judged if each.method == REFERENCE)
    px = _arcmin_per_px(found)
    rows: list[list[Cell]] = [
        [each.method, len(each.error), None if remark(each) else rms_of(each) / px, *cells(each, reference)]
        for each in judged
    ]
    columns = ["method", "predictions", "rms (px)", *(each.format(REFERENCE) for each in COLUMNS)]
    count = sum(len(each.pixel) for each in found.sittings)
    notes = (
        f"{len(found.sittings)} sittings of one wearer, {count} alignments. Intervals: bootstrap over the predicted "
        "sittings.",
        f"A pixel is {px:.2f}' in the middle of the screen that the authors calibrated with a camera.",
        "Rows that predict from another sitting do so from each of the others: their predictions are not independent.",
    )
    return [ReportTable("Alignments that were not fitted", columns, rows, notes), _noise_table(found.sittings, px)]


def full_setup(screen: Screen, eye_box: EyeBox) -> PinholeDisplay:
    """Return INDICA's full setup: the display of a screen of known pose and pitch, for any eye."""
    size = np.array([screen.panel.width_px, screen.panel.height_px], np.float64)
    across, down, _ = screen.rotation / screen.px_per_m  # rows: the screen's axes in the world, metres per pixel
    middle = -screen.rotation.T @ screen.translation
    corner = np.asarray(middle - (across * (size[0] - 1) + down * (size[1] - 1)) / 2, np.float64)
    matrix, depth = np.column_stack([across, down, corner]), np.array([0.0, 0.0, 1.0])
    box = Box(np.zeros(2), size)
    none = np.zeros((1, 3))
    return PinholeDisplay(
        screen.panel, eye_box, box, none, np.asarray(matrix, np.float64)[None], depth[None], numbers=8
    )


def recycled(sitting: Sitting, screen: Screen, eye_box: EyeBox, eye: FloatArray | None = None) -> PinholeDisplay:
    """Return INDICA's recycle setup: SPAAM of an old sitting, shifted by means of the screen's distance.

    Args:
        sitting: the old sitting.
        screen: screen, of which only the distance along the view is used.
        eye_box: eye box of the display.
        eye: (3,) position of the eye in that sitting; None for the position by SPAAM, as published.
    """
    projection = fit_projection(sitting.pixel, sitting.point, f"sitting {sitting.name}")
    inverse = np.asarray(np.linalg.inv(projection[:, :3]), np.float64)
    own = -inverse @ projection[:, 3]
    scale = np.linalg.norm(projection[2, :3])
    axis = projection[2, :3] / scale  # unit vector of the view direction
    # The authors add two coordinates along the view direction, one in SPAAM's frame, one in the screen's frame.
    distance = screen.translation[2] - own @ axis
    depth = np.array([0.0, 0.0, 1.0 / (distance * scale)])
    box = Box(np.zeros(2), np.array([screen.panel.width_px, screen.panel.height_px], np.float64))
    place = np.asarray(own if eye is None else eye, np.float64)
    return PinholeDisplay(screen.panel, eye_box, box, place[None], inverse[None], depth[None], numbers=_FREE + 1)


def as_captures(sittings: Sequence[Sitting], screen: Screen, eye_box: EyeBox, sigma_arcmin: float) -> DisplayCaptures:
    """Return alignments as captures from the tracked eyes, with one camera position per sitting."""
    counts = [len(each.pixel) for each in sittings]
    viewpoint = np.repeat([each.eye for each in sittings], counts, axis=0)
    point = np.concatenate([each.point for each in sittings])
    return DisplayCaptures(
        device="itoh_hmd_calibration",
        eye="right",
        eye_box=eye_box,
        panel=screen.panel,
        viewpoint=viewpoint,
        view_dir=normalised(point - viewpoint),
        pixel=np.concatenate([each.pixel for each in sittings]),
        capture=np.repeat(np.arange(len(sittings)), counts),
        sigma_arcmin=np.array(sigma_arcmin),
    )


def _judged(found: Alignments) -> list[HeldOut]:
    sittings, screen = found.sittings, found.screen
    eyes = np.array([each.eye for each in sittings])
    box = EyeBox(0.5 * (eyes.min(axis=0) + eyes.max(axis=0)), np.maximum(np.ptp(eyes, axis=0), _LEAST_SIZE))
    known = full_setup(screen, box)
    px = _arcmin_per_px(found)
    noise = px * float(np.sqrt(np.mean([_noise_px(each) ** 2 for each in sittings])))

    def error(at: int, pixel: FloatArray) -> FloatArray:
        """Return the angles between the pixels of a sitting's alignments and other pixels, by the calibrated screen."""
        seen = known.view_dir_of_pixel(np.stack([sittings[at].pixel, pixel]), sittings[at].eye).value
        return np.asarray(np.linalg.norm(seen[0] - seen[1], axis=-1) / ARCMIN)

    def pixels(display: DisplayMapping, at: int) -> FloatArray:
        towards = normalised(sittings[at].point - sittings[at].eye)
        return display.pixel_of_view_dir(towards, sittings[at].eye).value

    def from_others(method: str, predicted: Callable[[int, int], FloatArray], sources: int = len(sittings)) -> HeldOut:
        """Predict every other sitting from each of the first `sources`; `predicted` maps (source, target) to pixels."""
        pairs = [(s, t) for t in range(len(sittings)) for s in range(sources) if s != t]
        errors = [error(target, predicted(source, target)) for source, target in pairs]
        groups = [np.full(len(sittings[target].pixel), target) for _, target in pairs]
        return HeldOut(method, np.concatenate(errors), np.concatenate(groups))

    from_first = partial(from_others, sources=1)

    def left_out(method: str, fit: Callable[[DisplayCaptures], DisplayMapping]) -> HeldOut:
        def without(target: int) -> FloatArray:
            rest = [each for number, each in enumerate(sittings) if number != target]
            return error(target, pixels(fit(as_captures(rest, screen, box, noise)), target))

        group = np.repeat(np.arange(len(sittings)), [len(each.pixel) for each in sittings])
        return held_out(method, group, without)

    def alone(target: int) -> FloatArray:
        """Predict each alignment of a sitting by SPAAM of its other alignments."""
        mine = sittings[target]
        out = np.arange(len(mine.pixel))
        return np.array(
            [
                _project(fit_projection(mine.pixel[out != k], mine.point[out != k], mine.name), mine.point[k])
                for k in out
            ]
        )

    matrices = [fit_projection(each.pixel, each.point, each.name) for each in sittings]
    as_published = [recycled(each, screen, box) for each in sittings]
    by_tracker = [recycled(each, screen, box, each.eye) for each in sittings]
    group = np.repeat(np.arange(len(sittings)), [len(each.pixel) for each in sittings])
    return [
        held_out("SPAAM of the same sitting, alignment left out", group, lambda k: error(k, alone(k))),
        from_others(REFERENCE, lambda source, target: _project(matrices[source], sittings[target].point)),
        from_first("SPAAM of the first sitting", lambda s, t: _project(matrices[s], sittings[t].point)),
        from_others("INDICA recycle of another sitting", lambda s, t: pixels(as_published[s], t)),
        from_first("INDICA recycle of the first sitting (as published)", lambda s, t: pixels(as_published[s], t)),
        from_others("INDICA recycle of another sitting, old eye tracked too", lambda s, t: pixels(by_tracker[s], t)),
        held_out("INDICA full, screen as the authors calibrated it", group, lambda k: error(k, pixels(known, k))),
        *(left_out(f"{name}, fitted to the other sittings", fit) for name, fit in DISPLAYS.items()),
    ]


def _noise_table(sittings: Sequence[Sitting], px: float) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            each.name,
            len(each.pixel),
            np.sqrt(2.0) * _noise_px(each),
            np.sqrt(2.0) * _noise_px(each) * px,
            1e3 * each.eye_spread,
        ]
        for each in sittings
    ]
    both = float(np.sqrt(np.mean([2.0 * _noise_px(each) ** 2 for each in sittings])))
    rows.append(["all", sum(len(each.pixel) for each in sittings), both, both * px, None])
    columns = ["sitting", "alignments", "scatter (px)", "scatter (arcmin)", "scatter of the tracked eye (mm)"]
    notes = (
        "Scatter of the alignments: both axes, about SPAAM of the same sitting, corrected for the number of its "
        "parameters. It includes the wearer's aim, the marker's tracking and errors of the pinhole model.",
    )
    return ReportTable("Repeatability of the wearer's alignments", columns, rows, notes)


def _noise_px(sitting: Sitting) -> float:
    """Return the standard deviation per axis about SPAAM of the same sitting, pixels."""
    projection = fit_projection(sitting.pixel, sitting.point, f"sitting {sitting.name}")
    rest = _project(projection, sitting.point) - sitting.pixel
    return float(np.sqrt(np.sum(rest**2) / (rest.size - _FREE)))


def _project(projection: FloatArray, point: FloatArray) -> FloatArray:
    image = point @ projection[:, :3].T + projection[:, 3]
    return np.asarray(image[..., :2] / image[..., 2:])


def _arcmin_per_px(found: Alignments) -> float:
    """Return arcminutes per pixel in the middle of the calibrated screen, from the first sitting's eye."""
    eye, screen = found.sittings[0].eye, found.screen
    centre = 0.5 * np.array([screen.panel.width_px, screen.panel.height_px], np.float64)
    display = full_setup(screen, EyeBox(eye, np.full(3, _LEAST_SIZE)))
    first, second = display.view_dir_of_pixel(np.stack([centre, centre + [1.0, 0.0]]), eye).value
    return float(np.linalg.norm(second - first) / ARCMIN)
