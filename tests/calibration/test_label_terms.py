"""Errors by label as unknowns of a fit: found where captures tell them, carried where they do not, and named."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from calibration.toy_device import EYE_BOX, PLANE, bend_of, display_captures, grid_in_plane, see_through_captures
from present import present

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import ErrorShare, ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.calibration.label_terms import LabelTerm, board_terms, unseen_errors
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import CommonErrors
from wlr_render.error_sources import ErrorSource
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray

DEPTHS = (0.4, 0.8, 1.5)


def printed(seed: int, size_m: float = 2e-5, turns_deg: tuple[float, Any, float] | None = None) -> SeeThroughCaptures:
    """Captures of a board whose dots lie beside their places by random plane waves.

    Its poses are fitted to its dots; or it is turned from pose to pose, and its poses are exact.
    """
    rng = np.random.default_rng(seed)
    captures = see_through_captures(grid_in_plane(4, 4), DEPTHS, sigma_arcmin=0.1, seed=seed)
    angle = np.deg2rad(turns_deg or (0.0, 0.0, 0.0))[captures.target_pose]
    turn = np.moveaxis(np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), 2, 0)
    dot = np.einsum("nji,nj->ni", turn, captures.point[:, :2])
    waves, phase = rng.normal(0.0, 12.0, (2, 30, 2)), rng.uniform(0.0, 2 * np.pi, (2, 30))
    off = np.stack([np.cos(dot @ waves[axis].T + phase[axis]).sum(axis=1) for axis in (0, 1)], axis=-1)
    for pose in range(len(DEPTHS) if turns_deg is None else 1):
        rows = captures.target_pose == pose if turns_deg is None else np.full(len(dot), True)
        affine = np.column_stack([np.ones(rows.sum()), dot[rows]])
        off[rows] -= affine @ np.linalg.lstsq(affine, off[rows], rcond=None)[0]
    stated = captures.point.copy()
    stated[:, :2] -= size_m / np.sqrt(15.0) * np.einsum("nij,nj->ni", turn, off)
    target = np.column_stack([dot, np.zeros(len(dot))])
    return replace(captures, point=stated, target_point=target)


@cache
def of_printed(
    seed: int, size_m: float = 2e-5, turns_deg: tuple[float, Any, float] | None = None
) -> ModelFit[FittedSeeThrough]:
    return fit_see_through(printed(seed, size_m, turns_deg), "planar", 4)


def errors_arcmin(mapping: FittedSeeThrough, rng: np.random.Generator) -> tuple[FloatArray, Any]:
    """True and predicted error at random real points and viewpoints of the eye box."""
    low, high = EYE_BOX.at(np.array([[-1.0, -1, 0], [1, 1, 0]]))[:, :2]
    base = rng.uniform(low, high, (200, 2))
    tangents, depth = rng.uniform([-0.35, -0.25], [0.35, 0.25], (200, 2)), rng.uniform(*DEPTHS[::2], (200, 1))
    a, b = bend_of(base, tangents)
    point = np.hstack([base + b + depth * (tangents + a), PLANE.z - depth])
    viewpoint = PLANE.lift(base)
    seen = mapping.view_dir_of_real_point(point, viewpoint).value
    return arcmin_between(seen, dir_of_tangents(tangents)), mapping.sigma(point, viewpoint)


@pytest.mark.slow
def test_the_predicted_error_contains_printing_errors() -> None:
    ratios = []
    for has_target in (True, False):
        squares = []
        for seed in range(3):
            unlabelled = replace(printed(seed), target_point=np.full(3, np.nan))
            fit = of_printed(seed) if has_target else fit_see_through(unlabelled, "planar", 4)
            true, predicted = errors_arcmin(fit.mapping, np.random.default_rng(seed))
            squares.append([np.mean(true**2), np.mean(predicted**2)])
        ratios.append(np.sqrt(np.divide(*np.mean(squares, axis=0))))
    assert 0.7 < ratios[0] < 1.4
    assert ratios[1] > 1.5 * ratios[0]


def test_a_board_that_is_turned_tells_its_print_from_the_optics() -> None:
    def rms(turn_deg: float) -> FloatArray:
        fits = [of_printed(seed, 6e-5, (0.0, turn_deg, 0.0)) for seed in (1, 2)]
        errors = [errors_arcmin(each.mapping, np.random.default_rng(seed)) for seed, each in enumerate(fits)]
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=(0, 2))))

    assert np.all(rms(90.0) < 0.85 * rms(0.0))


def test_errors_whose_labels_captures_lack_are_named() -> None:
    seen = printed(0)
    recorded: dict[str, Any] = {"time_s": np.arange(len(seen)), "travel": 1.0, "visit": seen.capture}
    visits = np.unique(seen.capture)
    everything = replace(seen, common=CommonErrors(("lens",), visits, np.zeros((len(visits), 6, 1))), **recorded)
    assert unseen_errors(everything) == ()
    board = replace(everything, target_point=np.full(3, np.nan))
    assert unseen_errors(board) == ("printing errors and shape of the board (places on the board)",)
    assert [each.split()[0] for each in unseen_errors(seen)] == ["drift", "direction", "motions", "lens"]


def terms_of(dot: FloatArray, is_pose_fitted: bool, y_sign: float = 1.0) -> list[LabelTerm]:
    """Terms of a board at one pose, 2 m away and across the view; its y axis points up or down."""
    point = np.column_stack([dot * [1.0, y_sign], np.full(len(dot), -2.0)])
    by_point = np.tile(np.eye(2, 3) / 2.0, (len(dot), 1, 1))
    return board_terms(dot, point, np.zeros(len(dot), np.int64), by_point, is_pose_fitted)


def test_a_board_that_fills_no_area_has_no_field() -> None:
    dot = np.stack([np.linspace(0.0, 1.0, 20), np.zeros(20)], axis=-1)
    assert terms_of(dot, is_pose_fitted=True) == terms_of(np.full((20, 2), np.nan), is_pose_fitted=False) == []


def test_waves_do_what_no_pose_of_the_board_does_where_the_pose_was_fitted() -> None:
    dot = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.4, 0.4, 9)), axis=-1).reshape(-1, 2)
    fitted, stated = (terms_of(dot, each)[0] for each in (True, False))
    affine = np.linalg.qr(np.column_stack([np.ones(len(dot)), dot]))[0]
    assert np.abs(affine.T @ fitted.columns).max() == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(affine.T @ stated.columns) > 0.1 * np.linalg.norm(stated.columns)


def test_a_board_whose_y_axis_points_down_has_the_same_printing_errors() -> None:
    dot = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.4, 0.4, 9)), axis=-1).reshape(-1, 2)
    up, down = (terms_of(dot, True, sign)[0].columns for sign in (1.0, -1.0))
    np.testing.assert_allclose(down, up, atol=1e-12)
    assert np.linalg.norm(up) > 1.0


def test_a_board_whose_pose_was_not_fitted_to_its_dots_may_be_stretched() -> None:
    captures = printed(0)
    poses = np.unique(captures.target_pose)
    places = np.unique(captures.capture)
    known = CommonErrors((ErrorSource.TARGETS,), places, np.zeros((len(places), 6, 1)), None, poses)
    fits = of_printed(0), fit_see_through(replace(captures, common=known), "planar", 4)
    stated, fitted = (share_of(each, "printing errors of the board").arcmin for each in fits)
    assert stated > 1.2 * fitted


def lab_display(seed: int, raster: bool = False, size: int = 7) -> DisplayCaptures:
    """Captures in random order and off the raster, or along a raster; with the times of a lab."""
    rng = np.random.default_rng(seed)
    grid = grid_in_plane(size, size)
    places = grid if raster else rng.permutation(grid + rng.uniform(-0.1, 0.1, grid.shape) * EYE_BOX.size[:2])
    captures = display_captures(places, sigma_arcmin=0.25, seed=seed)
    return replace(
        captures, time_s=np.asarray(30.0 * captures.visits[1]), travel=np.sign(np.sin(2.3 * captures.visits[1]))
    )


def drifting(captures: DisplayCaptures, arcmin: float = 0.6) -> DisplayCaptures:
    """A camera that turns while it warms up."""
    warm = 1.0 - np.exp(-3.0 * captures.time_s / captures.time_s.max())
    turned = captures.tangents + np.outer(warm - warm.mean(), [arcmin, -0.5 * arcmin]) * ARCMIN
    return replace(captures, view_dir=dir_of_tangents(turned))


def screwed(captures: DisplayCaptures, size_m: float = 12e-6) -> DisplayCaptures:
    """A stage whose axis x has a lead screw with an error."""
    x, y, z = captures.viewpoint.T
    return replace(captures, viewpoint=np.column_stack([x + size_m * np.sin(2.0 * np.pi * x / 5e-3), y, z]))


def share_of(fit: ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough], source: str) -> ErrorShare:
    return next(each for each in fit.report.shares if each.source == source)


@pytest.mark.parametrize(
    ("wrong", "source", "size"),
    [(drifting, "drift", 0.2), (screwed, "stage axes", 12e-6 / np.sqrt(2.0))],
    ids=["drift", "screw"],
)
def test_the_size_of_an_error_is_found(wrong: Callable[..., Any], source: str, size: float) -> None:
    captures = lab_display(0)
    found = share_of(fit_display(wrong(captures), "planar", 3), source)
    sound = share_of(fit_display(captures, "planar", 3), source)
    assert found.size == pytest.approx(size, rel=0.5)
    assert present(sound.size) < 0.4 * present(found.size)
    assert sound.arcmin < 0.5 * found.arcmin


def test_an_error_that_varies_smoothly_along_an_axis_is_no_error_of_the_stage() -> None:
    """It looks like optics that the orders of the fit leave out."""
    captures = lab_display(1, raster=True)
    x, y, z = captures.viewpoint.T
    along = 2.0 * (x - x.mean()) / np.ptp(x)
    bent = replace(captures, viewpoint=np.column_stack([x + 1e-5 * (along**2 - 0.5), y, z]))
    sizes = [present(share_of(fit_display(each, "planar", 2), "stage axes").size) for each in (captures, bent)]
    assert sizes[1] < 1.5 * sizes[0]


def test_what_a_raster_does_not_show_is_carried() -> None:
    """Along a raster a drift looks like optics: with times the fit says that it is less sure."""
    ratios = []
    for raster in (True, False):
        captures = lab_display(1, raster)
        timed, untimed = (
            fit_display(each, "planar", 3)
            for each in (captures, replace(captures, time_s=np.full(len(captures), np.nan)))
        )
        drift = share_of(timed, "drift")
        ratios.append(drift.arcmin)
        assert timed.report.predicted_arcmin > untimed.report.predicted_arcmin
        assert not any(each.source == "drift" for each in untimed.report.shares)
    assert ratios[0] > 2.0 * ratios[1]


def test_shares_add_up_to_the_predicted_error() -> None:
    report = of_printed(0).report
    assert np.sqrt(sum(each.arcmin**2 for each in report.shares)) == pytest.approx(report.predicted_arcmin, rel=1e-6)
    assert report.shares == tuple(sorted(report.shares, key=lambda each: -each.arcmin))
    board = share_of(of_printed(0), "printing errors of the board")
    assert board.unit == "m"
    assert 0.3 < present(board.size) / 2e-5 < 3.0


def test_exact_captures_have_no_errors_by_label() -> None:
    captures = lab_display(0)
    exact = replace(captures, sigma_arcmin=np.zeros(len(captures)))
    assert [each.source for each in fit_display(exact, "planar", 3).report.shares] == ["noise and stage"]
