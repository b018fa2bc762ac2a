"""Residuals of the views and their derivatives, and the normal equations of all unknowns.

The errors of a board's features are eliminated, since no two of them meet (B. Triggs et al., "Bundle adjustment: a
modern synthesis" (2000), section 6). Huber weights hold off outliers.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.bench.board_views import EYEBALL, BoardView
from wlr_render.calibration.bench.state import BenchState, Key, stretch_terms
from wlr_render.calibration.bench.unknowns import Layout, Sizes
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Sums

_HUBER = 3.0  # sigmas from which a residual loses weight: 0.3 % of normal noise, which costs nothing


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """Residuals of one view, pixels, and their derivatives.

    Attributes:
        residual: (n, 2) seen minus predicted; NaN where the lens cannot see the point.
        by_motion: (n, 2, 6) of predicted by a small motion of camera_from_board, camera frame.
        by_lens: (n, 2, P). by_shape: (n, 2, 5). by_place: (n, 2, 3), by the feature's place.
        by_stretch: (n, 2, 4), or (n, 2, 0) where the image counts as not stretched.
    """

    residual: FloatArray
    by_motion: FloatArray
    by_lens: FloatArray
    by_shape: FloatArray
    by_place: FloatArray
    by_stretch: FloatArray


def residuals_of(state: BenchState, view: BoardView) -> ViewResiduals:
    """Residuals of a view and their derivatives."""
    shape, camera_from_board = state.shape[view.board], state.camera_from_board(view)
    point = transforms.apply(camera_from_board, shape.point_of(view.feature, view.point))
    seen = state.lens_of(view).project(point)
    turned = seen.by_point @ camera_from_board[:3, :3]
    by_motion = np.concatenate([seen.by_point @ -transforms.cross_matrix(point), seen.by_point], axis=-1)
    predicted, by_stretch = seen.pixel, np.zeros((len(point), 2, 0))
    if view.name in state.stretches:
        by_stretch = stretch_terms(view.pixel, state.lens_of(view).size_px)
        predicted = predicted + by_stretch @ state.stretches[view.name]
    return ViewResiduals(
        view.pixel - predicted, by_motion, seen.by_values, turned @ shape.by_low(view.point), turned, by_stretch
    )


Extra = Mapping[Key, Mapping[str, FloatArray]]
"""Further unknowns: by the name of a view, (6, k) motion of the board in its camera's frame."""


@dataclass(frozen=True, eq=False)
class _ViewEquations:
    """Weighted equations of one view in its local unknowns: lens, board's shape, motion of the board, stretch.

    Attributes:
        design: (n, 2, local). by_place: (n, 2, 3), by the places of the view's features. value: (n, 2), linearised
            readings, zero where all unknowns are at the middle of their priors.
        rows: (n,) of the features on the board.
        carry: (local, unknowns) from all unknowns to the local ones.
        chi_square: sum of squares. loss: Huber's. values: number of values seen. log_weight: sum over them.
    """

    design: FloatArray
    by_place: FloatArray
    value: FloatArray
    rows: IntArray
    carry: FloatArray
    chi_square: float
    loss: float
    values: int
    log_weight: float

    @classmethod
    def of(
        cls, state: BenchState, layout: Layout, sizes: Sizes, extra: Extra, before: FloatArray, view: BoardView
    ) -> "_ViewEquations":
        """Linearise a view; `before` (unknowns,) is how far they are from the middle of their priors."""
        part, shape = residuals_of(state, view), state.shape[view.board]
        sigma = view.sigma_px * sizes.noise[view.camera]
        seen = np.asarray(np.isfinite(part.residual).all(axis=1))
        residual = np.where(seen[:, None], part.residual, 0.0)
        length = np.sqrt(0.5 * np.sum(residual**2, axis=1)) / sigma
        weight = seen * np.sqrt(_HUBER / np.maximum(length, _HUBER)) / sigma
        near = np.minimum(length, _HUBER)
        local = np.concatenate([part.by_lens, part.by_shape, part.by_motion, part.by_stretch], axis=-1)
        design = np.where(seen[:, None, None], local, 0.0) * weight[:, None, None]
        by_place = np.where(seen[:, None, None], part.by_place, 0.0) * weight[:, None, None]
        rows = shape.rows_of(view.feature)
        carry = _carried(state, layout, extra, view, part)
        weighted = residual * weight[:, None]
        value = weighted + design @ (carry @ before) + np.einsum("nij,nj->ni", by_place, shape.place[rows])
        return cls(
            design,
            by_place,
            value,
            rows,
            carry,
            float(np.sum(weighted**2)),
            2.0 * float(np.sum(near * (2.0 * length - near))),
            2 * int(np.count_nonzero(seen)),
            2.0 * float(np.log(weight[seen]).sum()),
        )


def _carried(state: BenchState, layout: Layout, extra: Extra, view: BoardView, part: ViewResiduals) -> FloatArray:
    """(local, unknowns) local unknowns of a view by all unknowns."""
    blocks = state.board_motion(view)
    blocks |= {key: columns[view.name] for key, columns in extra.items() if view.name in columns}
    lens, low = part.by_lens.shape[-1], part.by_shape.shape[-1]
    stretch = part.by_stretch.shape[-1]
    carry = np.zeros((lens + low + 6 + stretch, len(layout.size)))
    carry[:lens, layout.where["lens", view.camera]] = np.eye(lens)
    carry[lens : lens + low, layout.where["shape", view.board]] = np.eye(low)
    if view.camera == EYEBALL and view.target is not None and lens:
        carry[:2, layout.where["focus", view.target]] = state.lens[EYEBALL].focal_px[:, None]
    for key, columns in blocks.items():
        carry[lens + low : lens + low + 6, layout.where[key]] = columns
    if stretch:
        carry[lens + low + 6 :, layout.where["stretch", view.name]] = np.eye(stretch)
    return carry


class Normal:
    """Normal equations of all unknowns, with the features' errors integrated out at given sizes.

    Attributes:
        gram: (unknowns, unknowns). moment: (unknowns,). square, count, log_weight: as of `evidence.Sums`.
        loss: Huber's, sigmas squared.
        chi_square, values: sum of squares and number of values, by camera.
        features: by board, covariance (f, 3, 3) where the other unknowns are known, mean (f, 3) where they are zero,
            and their mixed sums (unknowns, 3 f).
    """

    def __init__(self, state: BenchState, layout: Layout, sizes: Sizes, extra: Extra) -> None:
        """Sum over all views.

        Args:
            state: to linearise at.
            layout: of the unknowns.
            sizes: noise by camera and error of features by board.
            extra: further blocks of `layout`.
        """
        self.square, self.loss, self.log_weight = 0.0, 0.0, 0.0
        self.chi_square = {name: 0.0 for name in state.lens}
        self.values = {name: 0 for name in state.lens}
        before = np.concatenate([state.deviation(key) for key in layout.where if key not in extra])
        before = np.concatenate([before, np.zeros(len(layout.size) - len(before))])
        own = {name: np.zeros((len(each.feature), 3, 3)) for name, each in state.shape.items()}
        pull = {name: np.zeros((len(each.feature), 3)) for name, each in state.shape.items()}
        crosses: dict[str, list[FloatArray]] = {name: [] for name in state.shape}
        carries: dict[str, list[FloatArray]] = {name: [] for name in state.shape}
        carried, moments = [], []
        for view in state.observations.views:
            each = _ViewEquations.of(state, layout, sizes, extra, before, view)
            self.chi_square[view.camera] += each.chi_square
            self.values[view.camera] += each.values
            self.loss += each.loss
            self.log_weight += each.log_weight
            self.square += float(np.sum(each.value**2))
            flat = each.design.reshape(-1, each.design.shape[-1])
            carries[view.board].append(each.carry)
            carried.append((each.carry, (flat.T @ flat) @ each.carry))
            moments.append(flat.T @ each.value.ravel())
            cross = np.zeros((flat.shape[1], len(own[view.board]), 3))
            cross[:, each.rows] = np.einsum("nik,nij->knj", each.design, each.by_place)
            crosses[view.board].append(cross.reshape(flat.shape[1], -1))
            own[view.board][each.rows] += np.einsum("nik,nij->nkj", each.by_place, each.by_place)
            pull[view.board][each.rows] += np.einsum("nik,ni->nk", each.by_place, each.value)
        self.count = sum(self.values.values())
        count = len(layout.size)
        carry = np.concatenate([np.zeros((0, count)), *(each for each, _ in carried)])
        self.gram = carry.T @ np.concatenate([np.zeros((0, count)), *(each for _, each in carried)])
        self.moment = carry.T @ np.concatenate([np.zeros(0), *moments])
        cross_of = {name: np.concatenate(carries[name]).T @ np.concatenate(each) for name, each in crosses.items()}
        self._eliminate(sizes, cross_of, own, pull)

    def _eliminate(
        self,
        sizes: Sizes,
        cross: Mapping[str, FloatArray],
        own: Mapping[str, FloatArray],
        pull: Mapping[str, FloatArray],
    ) -> None:
        """Integrate the features' errors out."""
        self.features: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        for name, each in own.items():
            if not len(each):
                continue
            size = sizes.feature_m[name]
            inverse = np.linalg.inv(each + np.eye(3) / size**2)
            mean: FloatArray = np.einsum("nij,nj->ni", inverse, pull[name])
            by_feature = cross[name].reshape(len(cross[name]), -1, 3).transpose(1, 0, 2)
            half = (by_feature @ np.linalg.cholesky(inverse)).transpose(1, 0, 2).reshape(len(cross[name]), -1)
            self.gram -= half @ half.T  # BLAS calculates one triangle of such a product
            self.moment -= cross[name] @ mean.ravel()
            self.square -= float(np.sum(pull[name] * mean))
            self.features[name] = np.asarray(inverse), mean, cross[name]

    def sums(self, layout: Layout) -> Sums:
        """For the evidence, in units of the prior sizes that have no hyperparameter."""
        sums = Sums(0, 1, len(layout.size))
        sums.count, sums.square, sums.log_weight = self.count, self.square, self.log_weight
        sums.side_gram = layout.size[:, None] * self.gram * layout.size
        sums.side_moment = layout.size * self.moment
        return sums

    def features_at(self, vector: FloatArray) -> dict[str, FloatArray]:
        """(f, 3) errors of each board's features, where the other unknowns are `vector`."""
        return {
            name: mean - np.einsum("nij,nj->ni", inverse, (vector @ cross).reshape(-1, 3))
            for name, (inverse, mean, cross) in self.features.items()
        }

    def determined_features(self, name: str, size: float) -> float:
        """How many of the coordinates of a board's features the views determine, at their prior size."""
        inverse = self.features[name][0]
        return 3.0 * len(inverse) - float(np.trace(inverse, axis1=1, axis2=2).sum()) / size**2
