"""Errors of what a bench predicts, by the errors of its effects' coefficients."""

from dataclasses import replace

import numpy as np

from wlr_render.bench.bench_effects import AnyFunction, BenchEffect
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.numerics.arrays import FloatArray

_FEW = 400  # readings by which the principal errors are chosen
_TELLING = 0.02  # rms change of the readings, in sigma, below which an error is left out
_DECIMALS = 6  # of changes in sigma: directions of view are solved no better
_NEGLIGIBLE = 1e-6  # variance of coefficients, relative to the largest of their effect, below which they have no error


def effect_errors(predictor: Predictor) -> FloatArray:
    """Return the change (n, 2, k) of the predicted readings, in sigma, by the principal errors of the bench's effects.

    Each is one standard error; they are independent, as the effects of a bench are of each other. Effects without a
    covariance are exact.
    """
    effects = predictor.observations.nominal.effects
    roots = [_root(effect) for effect in effects]
    ends = np.cumsum([root.shape[1] for root in roots])
    count = int(ends[-1]) if roots else 0
    nothing = np.zeros((len(predictor.observations), 2, 0))
    if not count:
        return nothing

    def change(by: Predictor, errors: FloatArray) -> FloatArray:
        """Return the change (n, 2) of the readings by errors (count,) of all effects."""
        parts = np.split(errors, ends[:-1])
        moved = (_moved(*each) for each in zip(effects, roots, parts, strict=True))
        bench = replace(by.observations.nominal, effects=tuple(moved))
        away = by.residual(Explanation()) - by.residual_of_bench(bench)
        return np.asarray(np.round(np.nan_to_num(away), _DECIMALS), np.float64)

    few = predictor.of_rows(predictor.observations.spread(_FEW))
    columns = np.stack([change(few, error).ravel() for error in np.eye(count)], axis=1)
    sizes, axes = np.linalg.svd(columns, full_matrices=False)[1:]
    telling = axes[sizes > _TELLING * np.sqrt(len(columns))]
    return np.stack([change(predictor, axis) for axis in telling], axis=-1) if len(telling) else nothing


def _root(effect: BenchEffect) -> FloatArray:
    """Return a root (p, k) of the covariance of an effect's coefficients."""
    if effect.covariance is None:
        return np.zeros((0, 0))
    values, axes = np.linalg.eigh(effect.covariance)
    kept = values > _NEGLIGIBLE * values.max(initial=0.0)
    return np.asarray(axes[:, kept] * np.sqrt(values[kept]))


def _moved(effect: BenchEffect, root: FloatArray, errors: FloatArray) -> BenchEffect:
    """Return the effect with errors (k,) of its coefficients, in standard errors."""
    function = effect.function
    if not errors.any() or isinstance(function, AnyFunction):
        return effect
    coefficients = function.coefficients + (root @ errors).reshape(function.coefficients.shape)
    return replace(effect, function=replace(function, coefficients=coefficients))
