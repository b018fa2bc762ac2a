"""Errors by label: none on sound sessions, and each foreign error by its own label."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration.toy_device import EYE_BOX, PLANE, bend_of, display_captures, grid_in_plane, scattered
from numpy.typing import NDArray
from present import narrowed, present

from wlr_render.calibration import label_errors as label_error_module
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.calibration.label_errors import LabelError, label_errors
from wlr_render.captures.correspondences import AnyCaptures, Captures, DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import CommonErrors
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.jobs.headset import open_eye
from wlr_render.models import registration
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.see_through_model import SeeThroughModel

SIGMA = 0.25
DEPTHS = (0.6, 1.0, 1.7)


def places(seed: int, count: int) -> NDArray[Any]:
    """Positions in random order and off the raster, as `plan` proposes them."""
    rng = np.random.default_rng(seed)
    grid = grid_in_plane(count, count)
    return rng.permutation(grid + rng.uniform(-0.1, 0.1, grid.shape) * EYE_BOX.size[:2])


def timed(captures: AnyCaptures) -> AnyCaptures:
    """With the times and directions of travel that a session records, visit after visit."""
    visit = captures.visits[1]
    return replace(captures, time_s=np.asarray(30.0 * visit), travel=np.sign(np.sin(2.3 * visit)))


def display(seed: int, count: int = 7) -> DisplayCaptures:
    return timed(display_captures(places(seed, count), sigma_arcmin=SIGMA, seed=seed))


def flickering(seed: int) -> DisplayCaptures:
    """A camera that turns to and fro by half an arcminute, faster than any drift of a fit."""
    captures = display(seed)
    slot = np.floor(6.0 * captures.time_s / (captures.time_s.max() + 1.0))
    turn = np.outer((-1.0) ** slot, [0.4, -0.3]) * ARCMIN
    return replace(captures, view_dir=dir_of_tangents(captures.tangents + turn))


def board(seed: int, size_m: float = 0.0) -> SeeThroughCaptures:
    """Captures of one board at all poses; its printing errors are sums of waves shorter than the fit's."""
    rng, base = np.random.default_rng(seed), places(seed, 4)
    dot = np.stack(np.meshgrid(np.linspace(-0.25, 0.25, 13), np.linspace(-0.18, 0.18, 10)), axis=-1).reshape(-1, 2)
    waves, phase = rng.normal(0.0, 80.0, (2, 40, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 40))
    off = np.stack([np.cos(dot @ waves[axis].T + phase[axis]).sum(axis=1) for axis in (0, 1)], axis=-1)
    off *= size_m / np.sqrt(20.0)
    place, true = np.repeat(base, len(dot), axis=0), np.tile(dot, (len(base), 1)) + EYE_BOX.centre[:2]
    tangents, stated = [], []
    for depth in DEPTHS:
        seen = (true - place) / depth
        for _ in range(20):
            a, b = bend_of(place, seen)
            seen = (true - place - b) / depth - a
        tangents.append(seen)
        stated.append(np.column_stack([true - np.tile(off, (len(base), 1)), np.full(len(true), PLANE.z - depth)]))
    poses = len(DEPTHS)
    return timed(
        SeeThroughCaptures(
            device="toy",
            eye="right",
            eye_box=EYE_BOX,
            viewpoint=np.tile(PLANE.lift(place), (poses, 1)),
            view_dir=scattered(np.concatenate(tangents), SIGMA, seed),
            point=np.concatenate(stated),
            capture=np.tile(np.repeat(np.arange(len(base)), len(dot)), poses),
            target_pose=np.repeat(np.arange(poses), len(place)),
            sigma_arcmin=np.full(len(place) * poses, SIGMA),
            target_point=np.tile(np.column_stack([dot, np.zeros(len(dot))]), (len(base) * poses, 1)),
        )
    )


def curled(seed: int, size_arcmin: float = 0.05) -> SeeThroughCaptures:
    """A board that bends anew at each pose: a few smooth dents, rms over the readings."""
    captures, rng = board(seed), np.random.default_rng([seed, 1])
    dot, off = captures.target_point[:, :2], np.zeros((len(captures), 2))
    for pose in np.unique(captures.target_pose):
        centre, height = rng.uniform(-0.3, 0.3, (60, 2)), rng.standard_normal((60, 2))
        rows = captures.target_pose == pose
        off[rows] = np.exp(-np.sum((dot[rows, None] - centre) ** 2, axis=2) / (2.0 * 0.05**2)) @ height
    off *= size_arcmin / np.sqrt(np.mean(np.sum(off**2, axis=1)))
    return replace(captures, view_dir=dir_of_tangents(captures.tangents + off * ARCMIN))


def murky(seed: int) -> DisplayCaptures:
    """Noise of which neighbours in a photograph share a half."""
    captures, rng = display(seed, 5), np.random.default_rng([seed, 2])
    place, shared = captures.pixel / np.ptp(captures.pixel, axis=0), np.zeros((len(captures), 2))
    for visit in np.unique(captures.capture):
        rows = captures.capture == visit
        apart = np.linalg.norm(place[rows, None] - place[rows], axis=2)
        shared[rows] = np.linalg.cholesky(np.exp(-apart / 0.15)) @ rng.normal(0.0, SIGMA, (rows.sum(), 2))
    noisy = dir_of_tangents(captures.tangents + shared * ARCMIN)
    return replace(captures, view_dir=noisy, sigma_arcmin=np.full(len(captures), np.sqrt(2.0) * SIGMA))


@cache
def of_board(seed: int, size_m: float = 0.0) -> ModelFit[FittedSeeThrough]:
    return fit_see_through(board(seed, size_m), "planar", 3)


@cache
def of_flickering(seed: int) -> ModelFit[FittedDisplay]:
    return fit_display(flickering(seed), "planar", 3)


def labels_in(fit: ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]) -> tuple[LabelError, ...]:
    return label_errors(fit.smooth, fit.captures)[0]


def labels_of(captures: DisplayCaptures) -> tuple[LabelError, ...]:
    return labels_in(fit_display(captures, "planar", 3))


def said(found: tuple[LabelError, ...]) -> list[Any]:
    return [each.label for each in found if each.stands_out]


@pytest.mark.slow
def test_sound_sessions_show_nothing() -> None:
    found = [labels_of(display(seed, 4)) for seed in range(10)]
    found += [labels_in(of_board(seed)) for seed in range(2)]
    assert [said(each) for each in found if said(each)] == []
    ratios = [each.ratio for each in sum(found, ()) if each.label.startswith(("cell", "dot"))]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("fitted", "label", "size"), [(lambda seed: of_board(seed, 2e-5), "dot", 0.1), (of_flickering, "time", 0.5)]
)
def test_a_foreign_error_is_named_by_its_label(fitted: Callable[..., Any], label: str, size: float, seed: int) -> None:
    found = labels_in(fitted(seed))
    assert said(found) == [label]
    assert found[0].size_arcmin == pytest.approx(size, rel=0.4)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_smooth_error_shows_by_what_neighbouring_groups_have_in_common(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent errors of the groups, of which each has little, do not explain it better than noise."""
    captures = curled(seed)
    smooth = fit_see_through(captures, "planar", 3).smooth
    assert said(label_errors(smooth, captures)[0]) == ["dot and pose"]
    monkeypatch.setattr(label_error_module, "_LENGTHS", ())
    assert said(label_errors(smooth, captures)[0]) == []


def test_noise_that_neighbours_share_is_no_finding() -> None:
    captures = [murky(seed) for seed in range(3)]
    fits = [fit_display(each, "planar", 3).smooth for each in captures]
    assert all(smooth.readings.shared is not None for smooth in fits)
    found = [label_errors(smooth, each)[0] for smooth, each in zip(fits, captures, strict=True)]
    assert [said(each) for each in found] == [[], [], []]
    ratios = [each.ratio for each in sum(found, ()) if each.label in ("cell of the panel", "visit")]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_a_named_error_is_in_the_predicted_one() -> None:
    without = of_flickering(0)
    fit, captures = without.with_label_errors(), narrowed(without.captures, DisplayCaptures)
    (named,) = [each for each in fit.labels if each.matters]
    assert set(present(fit.mapping.spread).sources) == {"drift", "stage axes", "direction of travel"}
    sigma, own = (each.mapping.sigma(captures.pixel, captures.viewpoint) for each in (fit, without))
    assert np.sqrt(np.mean(sigma**2 - own**2)) == pytest.approx(named.in_model_arcmin, rel=0.1)
    assert fit.report.predicted_arcmin == fit.predicted_arcmin(fit.mapping) > without.report.predicted_arcmin


def test_a_budget_from_the_model_file_names_what_the_labels_do(tmp_path: Path) -> None:
    """The flicker bends the display's model alone, the print the world's alone; both models share all variables."""
    fit = calibrate(Captures(flickering(0), board(0, 2e-5)), display_degree=3, see_through_degree=3)
    models = open_eye(str(fit.save(tmp_path / "model.json")))
    rows, others = (np.random.default_rng(0).integers(0, len(each.captures), 300) for each in fit.both)
    shown, seen = (each.captures for each in fit.both)
    pixel, viewpoint = narrowed(shown, DisplayCaptures).pixel[rows], shown.viewpoint[rows]
    point = narrowed(seen, SeeThroughCaptures).point[others]
    display_model, see_through_model = (
        narrowed(models.display, DisplayModel),
        narrowed(models.see_through, SeeThroughModel),
    )
    found = registration.model_registration_covariance(display_model, see_through_model, pixel, viewpoint, point)
    rms = {name: np.sqrt(np.nanmean(np.trace(each, axis1=-2, axis2=-1))) for name, each in found.items()}
    of_display, of_see_through = (side.labels for side in fit.both)
    for name, labels, label in (
        ("drift", of_display, "time"),
        ("printing errors of the board", of_see_through, "dot"),
    ):
        (named,) = [each.in_model_arcmin for each in labels if each.label == label]
        assert rms[name] == pytest.approx(named, rel=0.2)
    more = [side.with_positions(viewpoint[:2]) for side in fit.both]
    spreads = [present(each.spread).sources for each in (*more, display_model)]
    assert spreads[0] == spreads[1] == spreads[2]


def test_an_error_of_the_readings_is_propagated_to_the_model() -> None:
    printed, exact = (of_board(0, size) for size in (2e-5, 0.0))
    changed = arcmin_between(printed.seen(printed.captures).value, exact.seen(printed.captures).value)
    (named,) = [each for each in label_errors(printed.smooth, printed.captures)[0] if each.stands_out]
    assert named.in_model_arcmin == pytest.approx(np.sqrt(np.mean(changed**2)), rel=0.3)
    assert not replace(named, own_arcmin=4.0 * named.in_model_arcmin).matters


def test_labels_are_those_that_the_captures_have() -> None:
    bare = labels_of(display_captures(places(0, 3), sigma_arcmin=SIGMA))
    assert {each.label for each in bare} == {
        "cell of the panel",
        "visit",
        "reading of stage axis x",
        "reading of stage axis y",
    }
    names = {each.label for each in labels_in(of_board(0))}
    assert {"cell of the field", "dot", "dot and pose", "time", "direction of travel"} <= names
    assert labels_of(display_captures(places(0, 3))) == ()  # exact data


def test_an_error_that_the_bench_states_is_no_finding() -> None:
    captures = flickering(0)
    names, first = np.unique(captures.capture, return_index=True)
    motion = np.zeros((len(names), 6, 2))
    slot = np.floor(6.0 * captures.time_s[first] / (captures.time_s.max() + 1.0))
    motion[:, 0, 0] = motion[:, 1, 1] = 2.0 * ARCMIN * (-1.0) ** slot
    stated = replace(captures, common=CommonErrors(("camera", "camera"), names, motion))
    assert said(labels_of(stated)) == []
