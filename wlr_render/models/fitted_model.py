"""Base classes of fitted models: queries in chunks over any leading axes, by a forward and a backward formula.

The formulas take and return tangents; only this module converts them from and to the protocols' unit directions.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_by_tangents, dir_of_tangents, tangents_of_dir
from wlr_render.mappings import EYE_BOX_MARGIN, EyeBox, Panel, QueryResult, Status
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.polynomial import Polynomial

_CHUNK = 65_536  # elements per block: a whole panel must not hold all its basis terms and Jacobians at once


@dataclass(frozen=True)
class Answer:
    """A model's answer for one chunk of m elements.

    Attributes:
        value: (m, k) values.
        inside: (m,) mask of inputs that lie in the boxes of the model's polynomials.
        solved: (m,) mask of converged solves; None for closed forms.
        start: (m, 2) solution to start the next query from; None for closed forms.
    """

    value: FloatArray
    inside: BoolArray
    solved: BoolArray | None = None
    start: FloatArray | None = None


@dataclass(frozen=True)
class Sensitivity:
    """Derivative of view tangents by a model's polynomial.

    Attributes:
        inputs: (m, variables) inputs of the polynomial.
        by_polynomial: (m, 2, outputs) derivative of the view tangents by the polynomial's values there.
    """

    inputs: FloatArray
    by_polynomial: FloatArray


@dataclass(frozen=True)
class DirectionErrors:
    """Errors that a fit expects of its view directions, in units of the unit direction (radians).

    Attributes:
        unshared: (..., 3, 3) covariance of the errors that the model does not share with the eye's other model.
        shared: (..., 3, k) change by each shared variable, all independent and standard normal.
        sources: (k,) source of error of each shared variable.
    """

    unshared: FloatArray
    shared: FloatArray
    sources: tuple[str, ...]


ChunkQuery = Callable[[FloatArray, FloatArray, FloatArray | None], Answer]
"""(subject (m, j), viewpoint (m, 3), start (m, 2) or None) -> Answer."""


def answer_in_chunks(
    query: ChunkQuery,
    subject: FloatArray,
    viewpoint: FloatArray,
    eye_box: EyeBox,
    warm_start: FloatArray | None = None,
) -> QueryResult:
    """Broadcast `subject` (..., j) against `viewpoint` (..., 3), query in chunks, and set the status of each element.

    Subjects that are not finite (directions that look backwards, points behind the eye) are MISS. Solves that did not
    converge and extrapolations that overflowed are NOT_CONVERGED. Viewpoints outside the eye box and
    inputs outside the fitted box are OUTSIDE_FIT and keep their value.

    Raises:
        BadInputError: `warm_start` is not of the query's shape.
    """
    subject, viewpoint = np.asarray(subject, dtype=np.float64), np.asarray(viewpoint, dtype=np.float64)
    lead = np.broadcast_shapes(subject.shape[:-1], viewpoint.shape[:-1])
    if warm_start is not None and warm_start.shape != (*lead, 2):
        raise BadInputError(f"warm_start has shape {warm_start.shape}; this query needs {(*lead, 2)}.")
    subject, viewpoint = _flat(subject, lead), _flat(viewpoint, lead)
    start = None if warm_start is None else _flat(warm_start, lead)
    parts = []
    # Extrapolations may overflow; their status reports it.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for first in range(0, max(len(subject), 1), _CHUNK):
            rows = slice(first, first + _CHUNK)
            answer = query(subject[rows], viewpoint[rows], None if start is None else start[rows])
            parts.append(_mapped(answer, subject[rows], viewpoint[rows], eye_box))
    value = np.concatenate([part.value for part in parts])
    starts = [part.warm_start for part in parts if part.warm_start is not None]
    return QueryResult(
        value.reshape(*lead, value.shape[1]),
        np.concatenate([part.status for part in parts]).reshape(lead),
        np.concatenate(starts).reshape(*lead, 2) if starts else None,
    )


def _flat(array: FloatArray, lead: tuple[int, ...]) -> FloatArray:
    return np.broadcast_to(array, (*lead, array.shape[-1])).reshape(-1, array.shape[-1])


def _mapped(answer: Answer, subject: FloatArray, viewpoint: FloatArray, eye_box: EyeBox) -> QueryResult:
    inside = answer.inside & eye_box.contains(viewpoint, EYE_BOX_MARGIN)
    solved = _all_finite(answer.value)
    if answer.solved is not None:
        solved = solved & answer.solved
    present = _all_finite(subject) & _all_finite(viewpoint)
    status = np.where(inside, Status.OK, Status.OUTSIDE_FIT).astype(np.uint8)
    status[~solved] = Status.NOT_CONVERGED
    status[~present] = Status.MISS
    good = (solved & present)[:, None]
    start = None if answer.start is None else np.where(good, answer.start, np.nan)
    return QueryResult(np.where(good, answer.value, np.nan), status, start)


def _all_finite(rows: FloatArray) -> BoolArray:
    return np.asarray(np.isfinite(rows).all(axis=1))


def joined(*columns: FloatArray) -> FloatArray:
    """Concatenate polynomial inputs (m, k) to (m, sum of k)."""
    return np.concatenate(columns, axis=-1)


class FittedModel(ABC):
    """Base of models made of polynomials; a subclass is a frozen dataclass and implements the formulas.

    Attributes:
        MODELLED: name of the attribute `modelled`.
        eye_box: box of valid viewpoints; a viewpoint outside is OUTSIDE_FIT.
        spread: covariance of `modelled`; None for models that were not fitted with one.
    """

    MODELLED: ClassVar[str]
    eye_box: EyeBox
    spread: Covariance | None = None

    @property
    def modelled(self) -> Polynomial:
        """The polynomial that defines the model; other polynomials only start solves."""
        modelled: Polynomial = getattr(self, self.MODELLED)
        return modelled

    def contraction(self) -> float:
        """Return the contraction of the solve over the eye box, see `models.contraction`; 0 for closed forms."""
        return 0.0

    def with_spread(self, spread: Covariance) -> Self:
        """Return the same model with another covariance."""
        model: Any = self  # every subclass is a dataclass
        changed: Self = replace(model, spread=spread)
        return changed

    @abstractmethod
    def _forward(self, subject: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        """Answer the forward query: pixels (m, 2) -> view tangents, or view tangents -> ray point, tangents (m, 5)."""

    @abstractmethod
    def _backward(self, subject: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        """Answer the backward query: view tangents (m, 2) -> pixels, or points (m, 3) -> view tangents."""

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        """Return the derivative of view tangents (m, 2) of pixels (m, 2) or real points (m, 3) by the polynomial."""
        raise BadInputError("this model has no covariance: only models fitted by maximum evidence have one.")

    @abstractmethod
    def view_dir(self, subject: FloatArray, viewpoint: FloatArray) -> QueryResult:
        """Return unit view directions (..., 3) of pixels (..., 2) or real points (..., 3), from viewpoints (..., 3)."""

    def direction_errors(self, subject: FloatArray, viewpoint: FloatArray, view_dir: FloatArray) -> DirectionErrors:
        """Return the expected errors of the directions (..., 3) from `view_dir`; NaN without a direction.

        Raises:
            BadInputError: the model has no covariance.
        """
        lead = view_dir.shape[:-1]
        subject, viewpoint = (_flat(np.asarray(each, np.float64), lead) for each in (subject, viewpoint))
        rows = np.flatnonzero(np.isfinite(view_dir.reshape(-1, 3)).all(axis=1))
        inputs, turned, spread = self._by_polynomial(subject[rows], viewpoint[rows], view_dir.reshape(-1, 3)[rows])
        covariance, deviation = spread.unshared_and_shared(inputs)
        unshared, shared = np.full((len(subject), 3, 3), np.nan), np.full((len(subject), 3, spread.shared), np.nan)
        unshared[rows], shared[rows] = turned @ covariance @ turned.transpose(0, 2, 1), turned @ deviation
        return DirectionErrors(unshared.reshape(*lead, 3, 3), shared.reshape(*lead, *shared.shape[1:]), spread.sources)

    def direction_changes(self, subject: FloatArray, viewpoint: FloatArray, view_dir: FloatArray) -> FloatArray:
        """Return the derivatives (n, 3, k) of finite answers (n, 3) of `view_dir` by each variable of the covariance.

        The variables are independent and standard normal, shared variables first, so that products of the derivatives
        are the covariance between different answers, too.

        Raises:
            BadInputError: the model has no covariance.
        """
        inputs, turned, spread = self._by_polynomial(subject, viewpoint, view_dir)
        return np.asarray(turned @ spread.changes(inputs))

    def _by_polynomial(
        self, subject: FloatArray, viewpoint: FloatArray, view_dir: FloatArray
    ) -> tuple[FloatArray, FloatArray, Covariance]:
        """Return the first polynomial's inputs (n, variables) and covariance, and the directions' derivative by it."""
        tangents = tangents_of_dir(view_dir)
        at = self._sensitivity(subject, viewpoint, tangents)
        if self.spread is None:  # models without a covariance are refused in `_sensitivity`
            raise BadInputError("this model has no covariance; fit it with this version: calibrate again.")
        return at.inputs, dir_by_tangents(tangents) @ at.by_polynomial, self.spread

    def sigma(self, subject: FloatArray, viewpoint: FloatArray) -> FloatArray:
        """Return the standard error (...) of `view_dir` in arcminutes: the rms angle that the fit predicts for itself.

        The rms is over both axes, NaN without a direction, and extrapolated where the status is OUTSIDE_FIT.

        Args:
            subject: pixels (..., 2) of a display, real points (..., 3) of a see-through model.
            viewpoint: (..., 3).

        Raises:
            BadInputError: the model has no covariance.
        """
        errors = self.direction_errors(subject, viewpoint, self.view_dir(subject, viewpoint).value)
        square = np.trace(errors.unshared, axis1=-2, axis2=-1) + np.sum(errors.shared**2, axis=(-2, -1))
        return np.asarray(np.sqrt(square) / ARCMIN)


class FittedDisplay(FittedModel):
    """Base of display models with a forward and a backward formula.

    Attributes:
        panel: the panel.
    """

    panel: Panel

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query of `mappings.DisplayMapping`."""
        return _as_directions(answer_in_chunks(self._forward, pixel, viewpoint, self.eye_box, warm_start))

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query of `mappings.DisplayMapping`."""
        tangents = tangents_of_dir(np.asarray(view_dir))
        return answer_in_chunks(self._backward, tangents, viewpoint, self.eye_box, warm_start)

    def view_dir(self, subject: FloatArray, viewpoint: FloatArray) -> QueryResult:
        """Return the view directions of pixels, `view_dir_of_pixel`."""
        return self.view_dir_of_pixel(subject, viewpoint)


class FittedSeeThrough(FittedModel):
    """Base of see-through models with a forward and a backward formula."""

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query of `mappings.SeeThroughMapping`."""
        tangents = tangents_of_dir(np.asarray(view_dir))
        return _as_directions(answer_in_chunks(self._forward, tangents, viewpoint, self.eye_box, warm_start))

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query of `mappings.SeeThroughMapping`."""
        in_front = _points_in_front(point, viewpoint)
        return _as_directions(answer_in_chunks(self._backward, in_front, viewpoint, self.eye_box, warm_start))

    def view_dir(self, subject: FloatArray, viewpoint: FloatArray) -> QueryResult:
        """Return the view directions of real points, `view_dir_of_real_point`."""
        return self.view_dir_of_real_point(subject, viewpoint)


def _as_directions(result: QueryResult) -> QueryResult:
    """Replace tangents, the last two columns of the values, by unit directions, three columns."""
    point, tangents = result.value[..., :-2], result.value[..., -2:]
    with np.errstate(over="ignore", invalid="ignore"):
        return replace(result, value=joined(point, dir_of_tangents(tangents)))


def _points_in_front(point: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return real points (..., 3), with NaN for points that are not in front of the viewpoint (..., 3)."""
    point, viewpoint = np.broadcast_arrays(np.asarray(point, dtype=np.float64), viewpoint)
    return np.where(point[..., 2:] < viewpoint[..., 2:], point, np.nan)
