from pathlib import Path

import numpy as np
import pytest
from present import present

from benchmarks.accuracy.lab_errors import LAB_SWITCHES
from benchmarks.accuracy.lab_statements import SHARED
from benchmarks.accuracy.labs import lab_captures
from benchmarks.trials import EvaluatedEye, truth
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.capture_file import load_captures
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import tangents_of_dir


def test_a_session_depends_on_its_seed_and_states_the_truth() -> None:
    first, true = lab_captures("birdbath28", seed=4, positions=4, noise_arcmin=0.3)
    again, _ = lab_captures("birdbath28", seed=4, positions=4, noise_arcmin=0.3)
    other, _ = lab_captures("birdbath28", seed=5, positions=4, noise_arcmin=0.3)
    for one, same, different in zip(first.both, again.both, other.both, strict=True):
        np.testing.assert_array_equal(one.view_dir, same.view_dir)
        assert one.view_dir.shape != different.view_dir.shape or np.any(one.view_dir != different.view_dir)
        assert np.all(one.sigma_arcmin == 0.3)
    assert true.workshop.seed == 4
    assert 1 <= len(true.bumped) <= 2
    assert len(true.shown.pixel) > 1000
    assert len(true.seen.point) == len(true.shown.pixel)


def test_a_session_is_a_capture_file(tmp_path: Path) -> None:
    captures, _ = lab_captures("birdbath28", positions=4, stated=("lens", "bow", "abbe", "repeatability"))
    again = load_captures(captures.save(tmp_path / "captures-right.npz"))
    for one, other in zip(captures.both, again.both, strict=True):
        np.testing.assert_array_equal(one.view_dir, other.view_dir)
        np.testing.assert_array_equal(one.time_s, other.time_s)
        assert present(one.common).sources == present(other.common).sources


@pytest.mark.slow
def test_a_capture_bumped_by_300_um_is_found() -> None:
    captures, true = lab_captures("birdbath28", seed=1, bump_um=(300.0, 300.0))
    shown, seen = captures.both
    few = Captures(select(shown, np.arange(len(shown)) % 5 == 0), select(seen, np.arange(len(seen)) % 5 == 0))
    for fit in calibrate(few).both:
        rows = [np.flatnonzero(fit.captures.visits[1] == each.capture)[0] for each in fit.smooth.moved]
        assert {int(fit.captures.capture[row]) for row in rows} == set(true.bumped.tolist())
        assert all(fit.captures.target_pose[row] <= 0 for row in rows)


@pytest.mark.slow
def test_a_capture_that_moved_by_3_mm_does_not_make_all_seem_to_move() -> None:
    """If motions that vary smoothly with the place told their size, all captures would move with this one."""
    captures, true = lab_captures("northstar", seed=22, bump_um=(3000.0, 3000.0))
    smooth = fit_display(present(captures.display)).smooth
    assert [each.capture for each in smooth.moved] == true.bumped.tolist()
    assert smooth.shift_m < 2e-5


def test_the_raster_is_a_serpentine_and_planned_places_are_off_it_in_random_order() -> None:
    raster, planned = (
        lab_captures("birdbath28", 0.0, positions=9, places=places)[0].both[0] for places in ("raster", "planned")
    )
    at = [part.stage[np.unique(part.capture, return_index=True)[1]] for part in (raster, planned)]
    steps = np.abs(np.diff(at[0], axis=0)[:, :2])
    assert np.all((steps > 1e-6).sum(axis=1) == 1)  # one axis moves at a time
    assert [len(np.unique(np.round(part[:, 0], 9))) for part in at] == [3, 9]
    np.testing.assert_allclose(np.abs(at[1][:, :2]).max(axis=0), np.abs(at[0][:, :2]).max(axis=0))
    with pytest.raises(BadInputError, match="10 camera positions do not make a square raster"):
        lab_captures("birdbath28", positions=10)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARED)
def test_stated_errors_have_about_the_size_of_the_true_ones(name: str) -> None:
    at = EvaluatedEye("birdbath28", "right", (10.0, 8.0, 6.0))
    square = np.zeros(2)
    for seed in range(4):
        captures, _ = lab_captures(at.device, seed=seed, positions=9, switches=(name,), noise_arcmin=1e-6)
        assert captures.display is not None
        part: DisplayCaptures | SeeThroughCaptures
        part, change = captures.display, present(captures.display.common).changes(captures.display, slice(None))
        if name == "bow":
            part = present(captures.see_through)
            exact = truth(at).see_through.view_dir_of_real_point(part.point, part.viewpoint).value
            moved = present(part.common).changes(part, slice(None)).point
            depth = (part.viewpoint - part.point)[:, 2, None, None]
            stated = (present(moved)[:, :2] + present(moved)[:, 2:] * part.tangents[:, :, None]) / depth
        else:
            exact = truth(at).display.view_dir_of_pixel(part.pixel, part.viewpoint).value
            stated = change.tangents  # the shifts by the arm change directions much less than the turns
        square += np.mean((tangents_of_dir(exact) - part.tangents) ** 2), np.mean(np.sum(stated**2, axis=-1))
    assert 0.7 < np.sqrt(square[1] / square[0]) < 1.35


def test_only_what_is_named_is_stated() -> None:
    captures, _ = lab_captures("birdbath28", positions=4, stated=("lens", "repeatability"))
    for part in captures.both:
        assert {source.split()[0] for source in present(part.common).sources} == {"lens"}
        assert part.motion is not None
        np.testing.assert_allclose(1e6 * part.motion.size[:, :3], 15.0, rtol=0.1)
        np.testing.assert_allclose(1e6 * part.motion.size[:, 3:], 5.0, rtol=0.1)
    nothing, _ = lab_captures("birdbath28", positions=4, stated=())
    perfect, _ = lab_captures("birdbath28", 0.0, positions=4, switches=LAB_SWITCHES)
    assert all(part.common is None and part.motion is None for part in (*nothing.both, *perfect.both))
