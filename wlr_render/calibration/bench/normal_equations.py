"""Residuals of the views and their derivatives, and the normal equations of all unknowns.

The errors of a board's features are eliminated, because no reading depends on two of them (B. Triggs et al., "Bundle
adjustment: a modern synthesis" (2000), section 6). Huber weights limit the effect of outliers.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.bench.bench_blocks import Key, Layout, Sizes
from wlr_render.calibration.bench.board_views import EYEBALL, BoardView
from wlr_render.calibration.bench.state import BenchState, stretch_terms
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.evidence import Sums

_HUBER = 3.0  # sigmas from which a residual loses weight; it affects only 0.3 % of normal noise
_ROUNDING = 1e-14  # relative increase of the diagonal that keeps confusable lens terms positive definite


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """Residuals of one view, pixels, and the derivatives of the predicted pixels.

    Attributes:
        residual: (n, 2) observed minus predicted pixels; NaN for points outside the lens model's domain.
        moved: (n, 3) displacement of the features by the board's shape, from their positions in the board's file.
        by_place: (n, 2, 3) derivative by the feature's position on the board.
        columns: (n, 2, k) derivative by further blocks of unknowns.
        by_motion: (n, 2, 6) derivative by a small motion of camera_from_board, camera frame.
        motion: (6, k) derivative of this motion by further blocks.
    """

    residual: FloatArray
    moved: FloatArray
    by_place: FloatArray
    columns: Mapping[Key, FloatArray]
    by_motion: FloatArray
    motion: Mapping[Key, FloatArray]


def residuals_of(state: BenchState, view: BoardView) -> ViewResiduals:
    """Return the residuals of a view and their derivatives."""
    shape, camera_from_board, lens = state.shape[view.board], state.camera_from_board(view), state.lens_of(view)
    place = shape.point_of(view.feature, view.point)
    point = transforms.apply(camera_from_board, place)
    seen = lens.project(point)
    turned = seen.by_point @ camera_from_board[:3, :3]
    columns: dict[Key, FloatArray] = {("lens", view.camera): seen.by_values}
    if view.camera == EYEBALL and view.target is not None and seen.by_values.shape[-1]:
        columns["focus", view.target] = seen.by_values[..., :2] @ state.lens[EYEBALL].focal_px[:, None]
    predicted = seen.pixel
    if (stretch := state.of("stretch").get(view.name)) is not None:
        columns["stretch", view.name] = stretch_terms(view.pixel, lens.size_px)
        predicted = predicted + columns["stretch", view.name] @ stretch
    by_motion = np.concatenate([seen.by_point @ -transforms.cross_matrix(point), seen.by_point], axis=-1)
    motion = state.board_motion(view, camera_from_board)
    return ViewResiduals(view.pixel - predicted, place - view.point, turned, columns, by_motion, motion)


Extra = Mapping[Key, Mapping[str, FloatArray]]
"""Further unknowns: motion (6, k) of the board in the camera's frame, by the name of a view."""


class Normal:
    """Normal equations of all unknowns, with the features' errors integrated out for given sizes.

    Attributes:
        gram: (unknowns, unknowns). moment: (unknowns,). square, count, log_weight: as in `evidence.Sums`.
        loss: Huber's loss, sigmas squared.
        chi_square, values: sum of squares and number of values, by camera.
        informed: (unknowns,) diagonal of `gram` by camera, before the features are integrated out; 0 for shapes.
        features: by board, covariance (f, 3, 3) of the features' errors for known other unknowns, mean (f, 3) for zero
            other unknowns, and mixed sums (unknowns, 3 f).
    """

    def __init__(self, state: BenchState, layout: Layout, sizes: Sizes, extra: Extra) -> None:
        """Sum over all views.

        Args:
            state: state for the linearisation.
            layout: layout of the unknowns.
            sizes: noise by camera, and error of features by board.
            extra: further blocks of `layout`.
        """
        count = len(layout.size)
        self.gram, self.moment = np.zeros((count, count)), np.zeros(count)
        self.square, self.loss, self.log_weight = 0.0, 0.0, 0.0
        self.chi_square = {name: 0.0 for name in state.lens}
        self.values = {name: 0 for name in state.lens}
        self.informed = {name: np.zeros(count) for name in state.lens}
        before = state.deviation(key for key in layout.where if key not in extra)
        before = np.concatenate([before, np.zeros(count - len(before))])
        number = {name: len(each.feature) for name, each in state.shape.items()}
        own = {name: np.zeros((features, 3, 3)) for name, features in number.items()}
        pull = {name: np.zeros((features, 3)) for name, features in number.items()}
        sums = {name: np.zeros((features, count, 3)) for name, features in number.items()}
        for view in state.observations.views:
            part, shape = residuals_of(state, view), state.shape[view.board]
            weight = self._weighted(view, part.residual, sizes.noise[view.camera])
            motion = {**part.motion, **{key: each[view.name] for key, each in extra.items() if view.name in each}}
            direct, moved = layout.columns([*part.columns]), layout.columns([*motion])
            columns, carry = np.concatenate([direct, moved]), np.concatenate([*motion.values()], axis=1)
            every = np.concatenate([*part.columns.values(), part.by_motion, part.by_place], axis=-1)
            every = np.where(weight[:, None, None] > 0, every, 0.0) * weight[:, None, None]
            local, by_place, rows = every[..., :-3], every[..., -3:], shape.rows_of(view.feature)
            flat, count = local.reshape(-1, local.shape[-1]), len(direct)
            value = np.where(weight[:, None] > 0, part.residual, 0.0) * weight[:, None]
            value += local[..., :count] @ before[direct] + local[..., count:] @ (carry @ before[moved])
            value += np.einsum("nij,nj->ni", by_place, part.moved)
            self.square += float(np.sum(value**2))
            products = flat.T @ flat
            half = np.concatenate([products[:, :count], products[:, count:] @ carry], axis=1)
            gram = np.concatenate([half[:count], carry.T @ half[count:]])
            self.gram[np.ix_(columns, columns)] += gram
            self.informed[view.camera][columns] += np.diag(gram)
            moment = flat.T @ value.ravel()
            self.moment[columns] += np.concatenate([moment[:count], carry.T @ moment[count:]])
            mixed = local.transpose(0, 2, 1) @ by_place
            mixed = np.concatenate([mixed[:, :count], carry.T @ mixed[:, count:]], axis=1)
            sums[view.board][np.ix_(rows, columns)] += mixed
            own[view.board][rows] += by_place.transpose(0, 2, 1) @ by_place
            pull[view.board][rows] += np.einsum("nik,ni->nk", by_place, value)
        self.count = sum(self.values.values())
        cross = {name: np.ascontiguousarray(each.transpose(1, 0, 2)) for name, each in sums.items()}
        for name, each in own.items():
            self._add_shape(layout.where["shape", name], state.boards[name].by_feature, cross[name], each, pull[name])
        self._eliminate(sizes, {name: each.reshape(len(each), -1) for name, each in cross.items()}, own, pull)

    def _add_shape(
        self, where: slice, by_feature: FloatArray, cross: FloatArray, own: FloatArray, pull: FloatArray
    ) -> None:
        """Add the shape of a board, which moves its features by `by_feature` (3 f, k)."""
        mixed = cross.reshape(len(cross), -1) @ by_feature
        of_features = (own @ by_feature.reshape(*own.shape[:2], -1)).reshape(by_feature.shape)
        self.gram[:, where] += mixed
        self.gram[where] += mixed.T
        self.gram[where, where] += by_feature.T @ of_features
        self.moment[where] += by_feature.T @ pull.ravel()
        cross[where] += of_features.T.reshape(-1, *pull.shape)

    def _weighted(self, view: BoardView, residual: FloatArray, noise: float) -> FloatArray:
        """Return Huber's weights (n,) of a view's features, 0 if not visible, and add their sums of squares."""
        seen, sigma = np.isfinite(residual).all(axis=1), view.sigma_px * noise
        length = np.where(seen, np.sqrt(0.5 * np.sum(residual**2, axis=1)), 0.0) / sigma
        weight = seen * np.sqrt(_HUBER / np.maximum(length, _HUBER)) / sigma
        near = np.minimum(length, _HUBER)
        self.chi_square[view.camera] += 2.0 * float(np.sum((length * weight * sigma) ** 2))
        self.values[view.camera] += 2 * int(np.count_nonzero(seen))
        self.loss += 2.0 * float(np.sum(near * (2.0 * length - near)))
        self.log_weight += 2.0 * float(np.log(weight[seen]).sum())
        return np.asarray(weight)

    def _eliminate(
        self,
        sizes: Sizes,
        cross: Mapping[str, FloatArray],
        own: Mapping[str, FloatArray],
        pull: Mapping[str, FloatArray],
    ) -> None:
        """Integrate out the features' errors."""
        self.features: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        for name, each in own.items():
            if not len(each):
                continue
            size = sizes.feature_m[name]
            inverse = np.linalg.inv(each + np.eye(3) / size**2)
            mean: FloatArray = np.einsum("nij,nj->ni", inverse, pull[name])
            by_feature = cross[name].reshape(len(cross[name]), -1, 3).transpose(1, 0, 2)
            half = (by_feature @ np.linalg.cholesky(inverse)).transpose(1, 0, 2).reshape(len(cross[name]), -1)
            self.gram -= half @ half.T  # BLAS computes only one triangle of this product
            self.moment -= cross[name] @ mean.ravel()
            self.square -= float(np.sum(pull[name] * mean))
            self.features[name] = np.asarray(inverse), mean, cross[name]

    def sums(self, layout: Layout) -> Sums:
        """Return the sums for the evidence, in units of the prior sizes without hyperparameters."""
        sums = Sums(0, 1, len(layout.size))
        sums.count, sums.square, sums.log_weight = self.count, self.square, self.log_weight
        sums.side_gram = layout.size[:, None] * self.gram * layout.size
        sums.side_gram[np.diag_indices_from(sums.side_gram)] *= 1.0 + _ROUNDING
        sums.side_moment = layout.size * self.moment
        return sums

    def features_at(self, vector: FloatArray) -> dict[str, FloatArray]:
        """Return the errors (f, 3) of each board's features for other unknowns `vector`."""
        return {
            name: mean - np.einsum("nij,nj->ni", inverse, (vector @ cross).reshape(-1, 3))
            for name, (inverse, mean, cross) in self.features.items()
        }

    def determined_features(self, name: str, size: float) -> float:
        """Return the effective number of feature coordinates of a board that the views determine, for a prior size."""
        inverse = self.features[name][0]
        return 3.0 * len(inverse) - float(np.trace(inverse, axis1=1, axis2=2).sum()) / size**2
