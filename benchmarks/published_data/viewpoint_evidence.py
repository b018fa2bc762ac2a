"""Evidence for display models from captures at two viewpoints, and optics or rig as cause of the residual.

Three models of one panel, each a set of polynomials over its pixels and nested in the next:

- the viewpoint is ignored: one direction per pixel (2 polynomials);
- one 3-D point per pixel: a direction and an inverse distance (3);
- a bundle of rays: a direction from each viewpoint (4).

Two viewpoints can refute the first two. They cannot test the bundle's assumption that a direction does not change along
its own ray; such a test needs viewpoints at different depths.

The two rays of a pixel meet if the pixel has one 3-D point. The angle between them where they pass (the misclosure) is
a pseudo-scalar: in mirror-symmetric eyes, optics give it opposite signs and an error of the rig gives it equal signs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.readings import FitReadings, Limits, angular_metric
from wlr_render.calibration.smooth_fit import SmoothFit
from wlr_render.calibration.smooth_search import fit
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised
from wlr_render.geometry.planes import BasePlane
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

IGNORED, POINT, BUNDLE = "viewpoint ignored", "one 3-D point per pixel", "bundle of rays"

_LIMITS = Limits(12, 0, 12)
_FOLDS = 8
_CELLS = 16  # cells per axis of the panel; cells are held out as a whole, and noise is estimated in each
_ROWS_PER_CELL = 12  # fewest rows per cell, twice the terms of the quadratic for the noise


@dataclass(frozen=True)
class ModelEvidence:
    """Prediction of left-out pixels by one model.

    Attributes:
        name: name of the model.
        polynomials: number of its polynomials.
        log_evidence: natural logarithm of the evidence; the model with the largest value is most probable.
        held_out_arcmin, standard_error: rms of the angle in held-out cells, and its uncertainty.
    """

    name: str
    polynomials: int
    log_evidence: float
    held_out_arcmin: float
    standard_error: float


@dataclass(frozen=True)
class EyeEvidence:
    """Evidence from one eye's captures; fields refer to the cells of the panel that both viewpoints see.

    Attributes:
        eye: "left" or "right".
        rows: measured directions of pixels that both viewpoints see.
        baseline_m: distance between the viewpoints.
        noise_arcmin: rms angle about a local quadratic in each cell and viewpoint, which no smooth model can explain.
        models: in the order of the module's docstring.
        cell: (n,) row * 16 + column.
        misclosure_arcmin: (n,) misclosure in the cells.
        misclosure_sigma_arcmin: rms uncertainty of the misclosure, from fits to two halves of the cells.
        image_dioptre: (n,) inverse distance, along the first ray, at which the two rays pass each other.
        rest_arcmin: (2, n, 2) mean of measured minus bundle in x and y, per viewpoint.
    """

    eye: str
    rows: int
    baseline_m: float
    noise_arcmin: float
    models: tuple[ModelEvidence, ...]
    cell: IntArray
    misclosure_arcmin: FloatArray
    misclosure_sigma_arcmin: float
    image_dioptre: FloatArray
    rest_arcmin: FloatArray


@dataclass(frozen=True)
class MirrorSplit:
    """Rms fields of two eyes in mirrored cells, split into the part with the optics' symmetry and the rest.

    Attributes:
        optics_arcmin, rig_arcmin: parts of the misclosure.
        optics_rest_arcmin, rig_rest_arcmin: (2,) parts of the bundle's residual, per viewpoint.
    """

    optics_arcmin: float
    rig_arcmin: float
    optics_rest_arcmin: FloatArray
    rig_rest_arcmin: FloatArray


@dataclass(frozen=True)
class ViewpointEvidence:
    """Evidence from the captures of one or both eyes; `split` needs both."""

    eyes: tuple[EyeEvidence, ...]
    split: MirrorSplit | None


def viewpoint_evidence(eyes: Sequence[DisplayCaptures]) -> ViewpointEvidence:
    """Judge the captures of one eye, or of the left and the right eye.

    Raises:
        BadInputError: an eye is given twice or not at all, there are not two viewpoints, or too few pixels are seen
            from both.
    """
    if not eyes or len({captures.eye for captures in eyes}) != len(eyes):
        raise BadInputError("viewpoint evidence: give the captures of one eye, or of the left and the right eye.")
    found = tuple(Survey.of(captures).evidence() for captures in eyes)
    return ViewpointEvidence(found, _mirror_split(*found) if len(found) == 2 else None)


@dataclass(frozen=True)
class Survey:
    """Captures of one eye: the pixels that both viewpoints see.

    Attributes:
        captures: captures of these pixels.
        second: (n,) whether a row belongs to the second viewpoint.
        cell: (n,) cell of each row; `kept` lists the cells.
        viewpoint: (2, 3).
    """

    captures: DisplayCaptures
    second: NDArray[np.bool_]
    cell: IntArray
    kept: IntArray
    viewpoint: FloatArray

    @classmethod
    def of(cls, captures: DisplayCaptures) -> "Survey":
        """Collect the pixels that both viewpoints see.

        Raises:
            BadInputError: there are not two viewpoints, or both see too few pixels.
        """
        names, first_row = np.unique(captures.capture, return_index=True)
        if len(names) != 2:
            raise BadInputError(
                f"viewpoint evidence: the {captures.eye} eye was captured from {len(names)} viewpoints and this test "
                "takes two; with more, fit and compare models by held-out viewpoints."
            )
        column, row = np.clip((captures.pixel / captures.panel.size_px * _CELLS).astype(np.int64), 0, _CELLS - 1).T
        cell, second = row * _CELLS + column, captures.capture == names[1]
        fewest = np.minimum(*(np.bincount(cell[second == which], minlength=_CELLS**2) for which in (False, True)))
        kept = np.flatnonzero(fewest >= _ROWS_PER_CELL)
        if len(kept) < 2 * _CELLS:
            raise BadInputError(
                f"viewpoint evidence: only {len(kept)} of {_CELLS**2} cells of the {captures.eye} eye's panel are seen "
                f"well from both viewpoints and {2 * _CELLS} are needed; capture more densely."
            )
        inside = np.isin(cell, kept)
        viewpoint = captures.viewpoint[first_row]
        return cls(select(captures, inside), second[inside], cell[inside], kept, viewpoint)

    @property
    def tangents(self) -> FloatArray:
        """Tangents (n, 2) of the measured directions."""
        return self.captures.tangents

    @property
    def fold(self) -> IntArray:
        """(n,) index of the fold, one of eight, in which a row is held out; cells stay together."""
        # Folds of scattered cells, because a whole column at the panel's edge would be extrapolated.
        scattered = np.random.default_rng(0).permutation(len(self.kept)) % _FOLDS
        return np.asarray(scattered[np.searchsorted(self.kept, self.cell)])

    @property
    def centres(self) -> FloatArray:
        """Panel pixels of the kept cells' centres, (cells, 2)."""
        unit = (np.stack([self.kept % _CELLS, self.kept // _CELLS], axis=-1) + 0.5) / _CELLS
        return np.asarray(unit * self.captures.panel.size_px)

    def multiplier(self, name: str) -> FloatArray:
        """Return factors (n, 2, polynomials): t = a; a - w q, see `PointPerPixelDisplay`; or a + (-1/2 or 1/2) b."""
        direction = np.tile(np.eye(2), (len(self.cell), 1, 1))
        if name == IGNORED:
            return direction
        if name == BUNDLE:
            return np.concatenate([direction, direction * (self.second - 0.5)[:, None, None]], axis=2)
        centre = self.viewpoint.mean(axis=0)
        crossing = BasePlane(float(centre[2])).carry(self.captures.viewpoint, self.tangents) - centre[:2]
        return np.concatenate([direction, -crossing[:, :, None]], axis=2)

    def fit(self, name: str, rows: NDArray[np.bool_]) -> SmoothFit:
        """Fit a model to some rows."""
        tangents = self.tangents[rows]
        return fit(
            FitReadings(
                inputs=self.captures.pixel[rows],
                is_place=np.zeros(2, dtype=bool),
                observed=tangents,
                multiplier=self.multiplier(name)[rows],
                metric=angular_metric(tangents),
                sigma=np.ones(len(tangents)),
                capture=self.cell[rows],
                motion=None,
                orders=_LIMITS.orders(2, 0),
            )
        )

    def evidence(self) -> EyeEvidence:
        """Return the evidence for all models."""
        everything = np.ones(len(self.cell), dtype=bool)
        fits = {name: self.fit(name, everything) for name in (IGNORED, POINT, BUNDLE)}
        models = tuple(self.judged(name, fitted) for name, fitted in fits.items())
        misclosure, dioptre = _crossing(fits[BUNDLE], self.centres, self.viewpoint)
        return EyeEvidence(
            eye=self.captures.eye,
            rows=len(self.cell),
            baseline_m=float(np.linalg.norm(self.viewpoint[1] - self.viewpoint[0])),
            noise_arcmin=self.noise_arcmin(),
            models=models,
            cell=self.kept,
            misclosure_arcmin=misclosure,
            misclosure_sigma_arcmin=self.misclosure_sigma_arcmin(),
            image_dioptre=dioptre,
            rest_arcmin=self.rest_arcmin(fits[BUNDLE]),
        )

    def noise_arcmin(self) -> float:
        """Return the rms angle about a local quadratic in each cell and viewpoint."""
        metric, sum_of_squares, freedom = angular_metric(self.tangents), 0.0, 0
        for cell in self.kept:
            for which in (False, True):
                rows = (self.cell == cell) & (self.second == which)
                pixel = self.captures.pixel[rows]
                design = basis(pixel, total_degree(2, 2), Box.around(pixel))
                angle = self.tangents[rows] * metric[rows, None]
                rest = angle - design @ np.linalg.lstsq(design, angle, rcond=None)[0]
                sum_of_squares += float(np.sum(rest**2))
                freedom += len(rest) - term_count(2, 2)
        return float(np.sqrt(sum_of_squares / freedom))

    def misclosure_sigma_arcmin(self) -> float:
        """Return the rms uncertainty of the misclosure, from two halves of the cells."""
        odd = (self.cell % _CELLS + self.cell // _CELLS) % 2 == 1
        first, second = (_crossing(self.fit(BUNDLE, half), self.centres, self.viewpoint)[0] for half in (odd, ~odd))
        return 0.5 * rms(first - second)

    def judged(self, name: str, fitted: SmoothFit) -> ModelEvidence:
        """Rate a model by its evidence and by held-out cells."""
        fold = self.fold
        squares = np.array([fitted.left_out(fold == number)[0] ** 2 for number in range(_FOLDS)])
        rms = float(np.sqrt(np.average(squares, weights=np.bincount(fold))))
        error = float(np.std(squares, ddof=1) / np.sqrt(_FOLDS) / (2.0 * rms))
        return ModelEvidence(name, self.multiplier(name).shape[2], fitted.posterior.log_evidence, rms, error)

    def rest_arcmin(self, bundle: SmoothFit) -> FloatArray:
        """Return the mean (2, cells, 2) of measured minus bundle, per viewpoint and cell."""
        mean, difference = _mean_and_difference(bundle, self.captures.pixel)
        fitted = mean + (self.second - 0.5)[:, None] * difference
        rest = (self.tangents - fitted) * angular_metric(self.tangents)[:, None]
        return np.stack(
            [
                [rest[(self.cell == cell) & (self.second == which)].mean(axis=0) for cell in self.kept]
                for which in (False, True)
            ]
        )


def _mean_and_difference(bundle: SmoothFit, pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tangents (n, 2): their mean over both viewpoints, and the second viewpoint's less the first's."""
    mean, difference = np.split(bundle.polynomial(pixel), 2, axis=1)
    return mean, difference


def _crossing(bundle: SmoothFit, pixel: FloatArray, viewpoint: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return misclosure (n,), arcminutes, right-handed about the baseline, and inverse distance along the first ray."""
    mean, difference = _mean_and_difference(bundle, pixel)
    first, second = dir_of_tangents(mean - 0.5 * difference), dir_of_tangents(mean + 0.5 * difference)
    baseline = viewpoint[1] - viewpoint[0]
    plane = normalised(np.cross(baseline, first))
    misclosure = np.arcsin(np.sum(plane * second, axis=1)) / ARCMIN
    # Within the plane of baseline b and first ray f, the second ray s crosses f at distance n.(b x s) / n.(f x s).
    across, along = np.cross(first, second), np.cross(baseline, second)
    return misclosure, np.asarray(np.sum(plane * across, axis=1) / np.sum(plane * along, axis=1))


def _mirror_split(one: EyeEvidence, other: EyeEvidence) -> MirrorSplit:
    mirrored = other.cell // _CELLS * _CELLS + (_CELLS - 1 - other.cell % _CELLS)
    cells, of_one, of_other = np.intersect1d(one.cell, mirrored, return_indices=True)
    if len(cells) == 0:
        raise BadInputError("viewpoint evidence: the eyes see no cells that mirror each other; capture one field.")
    misclosure = one.misclosure_arcmin[of_one], other.misclosure_arcmin[of_other]
    rest, mirrored_rest = one.rest_arcmin[:, of_one], other.rest_arcmin[:, of_other] * [-1.0, 1.0]
    return MirrorSplit(
        optics_arcmin=rms(misclosure[0] - misclosure[1]) / 2,
        rig_arcmin=rms(misclosure[0] + misclosure[1]) / 2,
        optics_rest_arcmin=vector_rms(rest + mirrored_rest) / 2,
        rig_rest_arcmin=vector_rms(rest - mirrored_rest) / 2,
    )


def rms(values: FloatArray) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def vector_rms(field: FloatArray) -> FloatArray:
    """Return the root mean square length (viewpoints,) of vectors (viewpoints, cells, 2)."""
    return np.asarray(np.sqrt(np.mean(np.sum(field**2, axis=2), axis=1)))
