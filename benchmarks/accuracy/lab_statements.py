"""Statements of a lab about its errors: common errors and motions, with sizes within 10 % of the true sizes."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from benchmarks.accuracy.workshop_captures import HALF_DIAGONAL_PX, LabBoard, LabCamera
from wlr_render.captures.correspondences import AnyCaptures, Captures
from wlr_render.captures.feature_captures import REAL_POINT, CaptureMotionPrior, CommonErrors, point_terms
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.workshop import ARM_M, SHIFT_UM, WOBBLE_URAD, Workshop

SHARED = ("lens", "pupil", "bow", "abbe")
"""Names of the errors that all captures share and a lab can state."""
_WITHIN = 0.1  # relative error of a stated size
_COUNTS = {"lens": 9, "pupil": 1, "bow": 3, "abbe": 12}  # number of variables of each source
_LENS_ORDERS = np.array([(i, j) for i in range(8) for j in range(8 - i)])


def with_motion(captures: Captures, level: float, rng: np.random.Generator) -> Captures:
    """State the repeatability of the stage at each visit."""
    size = 1e-6 * level * np.repeat([WOBBLE_URAD, SHIFT_UM], 3) * rng.uniform(1.0 - _WITHIN, 1.0 + _WITHIN, 6)

    def stated(part: AnyCaptures) -> AnyCaptures:
        visits = np.unique(part.visit)
        return replace(part, motion=CaptureMotionPrior(visits, np.tile(size, (len(visits), 1)), _WITHIN))

    display, see_through = captures.both
    return Captures(stated(display), stated(see_through))


def with_common(
    captures: Captures, setup: CaptureSetup, workshop: Workshop, named: Collection[str], rng: np.random.Generator
) -> Captures:
    """State errors that all captures share, some of `SHARED`, in terms that a lab would use."""
    factors = dict(zip(SHARED, rng.uniform(1.0 - _WITHIN, 1.0 + _WITHIN, len(SHARED)), strict=True))
    statement = _Statement(setup, workshop, {name: float(factors[name]) for name in named})
    display, see_through = captures.both
    return Captures(
        replace(display, common=statement.common(display)), replace(see_through, common=statement.common(see_through))
    )


@dataclass(frozen=True, eq=False)
class _Statement:
    """Sizes of the errors that a lab states.

    Attributes:
        setup, workshop: the bench.
        factors: ratio of stated to true size, by source.
    """

    setup: CaptureSetup
    workshop: Workshop
    factors: dict[str, float]

    def common(self, part: AnyCaptures) -> CommonErrors:
        """Return the common errors of captures."""
        sources = tuple(name for name in self.factors for _ in range(_COUNTS[name]))
        start = {name: sources.index(name) for name in self.factors}
        visits, first = np.unique(part.visit, return_index=True)
        poses = np.arange(len(self.setup.target_depths_m) if part.kind == REAL_POINT else 0)
        target, focus = np.zeros((len(poses), 7, 3, len(sources))), np.zeros((len(poses), len(sources)))
        motion = np.zeros((len(visits), 6, len(sources)))
        change = np.zeros((len(self._unit), 2, len(sources)))
        for name, factor in self.factors.items():
            columns = slice(start[name], start[name] + _COUNTS[name])
            if name == "lens":
                change[..., columns] = factor * self._camera.half_diagonal * _lens_terms(self.workshop, self._unit)
            elif name == "pupil" and len(poses):
                change[..., start[name]] = factor * self._mean_inverse_m * self._pupil_shift
                focus[:, start[name]] = factor * self._pupil_slope
            elif name == "pupil":
                change[..., start[name]] = factor * self._panel_by_pupil()
            elif name == "bow" and len(poses):
                target[..., columns] = factor * _bow_terms(self.workshop, LabBoard.of(self.setup))
            elif name == "abbe":
                motion[..., columns] = factor * _abbe_terms(self.workshop, part.stage[first])
        return CommonErrors(sources, visits, motion, self._polynomial(change), poses, target, focus)

    @cached_property
    def _camera(self) -> LabCamera:
        return LabCamera.of(self.setup)

    @cached_property
    def _unit(self) -> FloatArray:
        """Image positions (n, 2) of the camera's pixels."""
        return self._camera.unit_of_dir(self.setup.camera_dirs())

    @property
    def _mean_inverse_m(self) -> float:
        return float(np.mean(1.0 / np.array(self.setup.target_depths_m)))

    @property
    def _pupil_shift(self) -> FloatArray:
        """Change (n, 2) of the tangents of a point 1 m away due to the pupil's travel."""
        return np.asarray(self.workshop.pupil_m(self._unit)[:, None] * self._unit * self._camera.half_diagonal)

    @property
    def _pupil_slope(self) -> FloatArray:
        """Relative change (p,) of the tangents at each pose due to the pupil's travel, less that at the mean pose."""
        square = np.sum(self._unit**2, axis=1)
        travel = float(np.sum(self.workshop.pupil_m(self._unit) * square) / np.sum(square))
        return np.asarray(travel * (1.0 / np.array(self.setup.target_depths_m) - self._mean_inverse_m))

    def _panel_by_pupil(self) -> FloatArray:
        """Return the change (n, 2) of the tangents of the panel's pixels due to the pupil's travel."""
        eye, view_dir, rotation = self.setup.truth, self.setup.camera_dirs(), self._camera.device_from_camera
        pixel = eye.display.pixel_of_view_dir(view_dir, eye.eye_box.centre).value
        along = -self.workshop.pupil_m(self._unit)[:, None] * rotation[:, 2]
        moved = eye.display.view_dir_of_pixel(pixel, eye.eye_box.centre + along).value
        return np.asarray(tangents_of_dir(moved @ rotation) - tangents_of_dir(view_dir @ rotation))

    def _polynomial(self, change: FloatArray) -> Polynomial:
        """Return changes (n, 2, k) of tangents as a function of the tangents."""
        known = np.isfinite(change).all(axis=(1, 2))
        design = np.polynomial.chebyshev.chebvander2d(self._unit[known, 0], self._unit[known, 1], [7, 7])
        rows = design.reshape(-1, 8, 8)[:, *_LENS_ORDERS.T]
        terms = np.linalg.lstsq(rows, change[known].reshape(len(rows), -1), rcond=None)[0]
        box = Box(np.full(2, -self._camera.half_diagonal), np.full(2, self._camera.half_diagonal))
        return Polynomial(_LENS_ORDERS, box, np.asarray(terms))


def _lens_terms(workshop: Workshop, unit: FloatArray) -> FloatArray:
    """Return tangential, prism and radial terms (n, 2, 9) of the lens, in half diagonals, with the true total rms."""
    (x, y), square = unit.T, np.sum(unit**2, axis=1)
    zero = np.zeros_like(x)
    terms = [(2 * x * y, square + 2 * y * y), (square + 2 * x * x, 2 * x * y)]
    terms += [(square**n, zero) for n in (1, 2)] + [(zero, square**n) for n in (1, 2)]
    terms += [(x * square**n, y * square**n) for n in (1, 2, 3)]
    shapes = np.moveaxis(np.array(terms), 0, -1).swapaxes(0, 1)
    size = np.sqrt(np.mean(workshop.lens_px(unit) ** 2) / len(terms)) / HALF_DIAGONAL_PX
    return np.asarray(size * shapes / np.sqrt(np.mean(shapes**2, axis=(0, 1))))


def _bow_terms(workshop: Workshop, board: LabBoard) -> FloatArray:
    """Return the change (p, 7, 3, 3) of each pose's points due to three quadratic heights, see `CommonErrors`."""
    dots = board.dots(0)
    rms = np.sqrt(np.mean(workshop.height_m(dots[:, :2] / board.half_m) ** 2))
    x, y = (dots[:, :2] / board.half_m).T
    heights = np.stack([x * x - np.mean(x * x), x * y, y * y - np.mean(y * y)], axis=-1)
    heights *= rms / np.sqrt(3.0 * np.mean(heights**2, axis=0))
    terms = []
    for pose in board.device_from_target:
        point = dots @ pose[:3, :3].T + pose[:3, 3]
        by_terms = np.linalg.lstsq(point_terms(point), heights, rcond=None)[0]
        terms.append(by_terms[:, None, :] * pose[:3, 2][None, :, None])
    return np.stack(terms)


def _abbe_terms(workshop: Workshop, reading: FloatArray) -> FloatArray:
    """Return motions (m, 6, 12): each rotation, linear and quadratic in the readings of x and y, with the true rms."""
    turn = workshop.only("abbe").stage_motion(reading, np.ones_like(reading))[:, :3]
    modes = np.column_stack([reading[:, :2], reading[:, :2] ** 2 - np.mean(reading[:, :2] ** 2, axis=0)])
    modes = modes / np.maximum(np.sqrt(np.mean(modes**2, axis=0) * modes.shape[1]), 1e-12)
    turns = np.zeros((len(reading), 3, 12))
    for axis in range(3):
        turns[:, axis, 4 * axis : 4 * axis + 4] = modes * np.sqrt(np.mean(turn[:, axis] ** 2))
    return np.concatenate([turns, np.cross(turns, ARM_M[None, :, None], axis=1)], axis=1)
