"""Errors that captures share: what they do to rows, against captures restated by hand; their file; refusals."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from scipy.spatial.transform import Rotation

from wlr_render.captures.capture_file import load_captures
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, with_copies
from wlr_render.captures.feature_captures import CommonErrors, point_terms
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree

RNG = np.random.default_rng(1)
EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
TURNED = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
IN_CAMERA = dir_of_tangents(RNG.uniform(-0.3, 0.3, (12, 2)))
ROWS = {
    "viewpoint": EYE_BOX.centre + RNG.normal(0, 0.002, (12, 3)),
    "view_dir": IN_CAMERA @ TURNED.T,
    "capture": np.arange(12) // 4,
    "sigma_arcmin": 0.5,
    "device_from_camera": TURNED,
    "device": "toy",
    "eye": "left",
    "eye_box": EYE_BOX,
}
SOURCES = ("lens", "stage", "targets")
LENS = Polynomial(total_degree(2, 2), Box(np.full(2, -0.5), np.full(2, 0.5)), RNG.normal(0, 1e-6, (6, 6)))
COMMON = CommonErrors(
    SOURCES,
    np.arange(3),
    RNG.normal(0, 1e-6, (3, 6, 3)),
    LENS,
    np.array([4, 7]),
    RNG.normal(0, 1e-6, (2, 7, 3, 3)),
    RNG.normal(0, 1e-6, (2, 3)),
)
OF_PANEL = dataclasses.replace(COMMON, target_pose=np.zeros(0, int), target=np.zeros(0), focus=np.zeros(0))
DISPLAY = DisplayCaptures(panel=Panel(10, 8), pixel=RNG.uniform(0, 8, (12, 2)), **ROWS, common=OF_PANEL)
SEE_THROUGH = SeeThroughCaptures(
    point=ROWS["viewpoint"] + 0.7 * ROWS["view_dir"],
    target_pose=np.tile([4, 7], 6),
    **ROWS,
    common=COMMON,
)


def restated(variable: int) -> tuple[Any, FloatArray, Any]:
    """Viewpoints, tangents and points of the see-through rows with one variable at 1, each error applied exactly."""
    motion, pose = COMMON.motion[..., variable][ROWS["capture"]], np.arange(12) % 2
    tangents = tangents_of_dir(IN_CAMERA)
    change = LENS(tangents).reshape(12, 2, 3)[..., variable] + tangents * COMMON.focus[pose, variable, None]
    direction = dir_of_tangents(tangents + change) @ TURNED.T
    direction = Rotation.from_rotvec(motion[:, :3]).apply(direction)
    moved = np.einsum("nt,nta->na", point_terms(SEE_THROUGH.point), COMMON.target[pose][..., variable])
    return motion[:, 3:], tangents_of_dir(direction) - SEE_THROUGH.tangents, moved


@pytest.mark.parametrize("variable", [0, 1, 2])
def test_changes_are_those_of_restated_captures(variable: int) -> None:
    changes = COMMON.changes(SEE_THROUGH, slice(None))
    for found, expected in zip((changes.viewpoint, changes.tangents, changes.point), restated(variable), strict=True):
        np.testing.assert_allclose(present(found)[..., variable], expected, rtol=1e-4, atol=1e-10)
    some = COMMON.changes(SEE_THROUGH, np.array([5, 2]))
    np.testing.assert_array_equal(some.tangents, changes.tangents[[5, 2]])


def test_a_panel_has_no_points_and_no_focus() -> None:
    changes = OF_PANEL.changes(DISPLAY, slice(None))
    assert changes.point is None
    no_focus = dataclasses.replace(COMMON, focus=np.zeros((2, 3))).changes(SEE_THROUGH, slice(None))
    np.testing.assert_allclose(changes.tangents, no_focus.tangents)


def test_a_turn_of_a_target_is_linear_in_its_points() -> None:
    turn, points = np.array([0.1, 0.2, -0.3]), SEE_THROUGH.point
    target = np.zeros((7, 3))
    target[1:4] = np.cross(turn, np.eye(3))
    np.testing.assert_allclose(point_terms(points) @ target, np.cross(turn, points))


def test_combinations_are_those_of_the_changes() -> None:
    root = RNG.normal(size=(3, 2))
    combined = COMMON.combined(root, ("lens", "stage"))
    before, after = (each.changes(SEE_THROUGH, slice(None)) for each in (COMMON, combined))
    for name in ("viewpoint", "tangents", "point"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name) @ root, atol=1e-15)


def test_copies_of_a_capture_share_its_errors() -> None:
    copied = with_copies(DISPLAY, np.array([4, 5, 0]), np.array([0, 0, 1]))
    motion = present(copied.common).of(copied.visits[0])[copied.visits[1]]
    np.testing.assert_array_equal(motion[12:], COMMON.motion[[1, 1, 0]])
    np.testing.assert_array_equal(motion[:12], COMMON.motion[ROWS["capture"]])


@pytest.mark.parametrize("lens", [LENS, None])
def test_a_file_keeps_them(tmp_path: Path, lens: Polynomial | None) -> None:
    shown = dataclasses.replace(DISPLAY, common=dataclasses.replace(present(DISPLAY.common), lens=lens))
    seen = dataclasses.replace(SEE_THROUGH, common=dataclasses.replace(present(SEE_THROUGH.common), lens=lens))
    read = load_captures(Captures(shown, seen).save(tmp_path / "captures.npz"))
    for before, after in ((shown, read.display), (seen, read.see_through)):
        assert after is not None
        assert after.common is not None
        assert after.common.sources == SOURCES
        assert (after.common.lens is None) == (lens is None)
        for one, other in (
            (present(present(each).common).changes(present(each), slice(None)) for each in (before, after)),
        ):
            np.testing.assert_array_equal(one.tangents, other.tangents)
            np.testing.assert_array_equal(one.viewpoint, other.viewpoint)
            assert (one.point is None) == (other.point is None)
            if one.point is not None:
                np.testing.assert_array_equal(one.point, other.point)


@pytest.mark.parametrize("coefficients", [np.array(1e-6), np.zeros(6), np.zeros((6, 4))])
def test_a_lens_of_other_shape_in_a_file_is_refused(tmp_path: Path, coefficients: FloatArray) -> None:
    path = Captures(DISPLAY, SEE_THROUGH).save(tmp_path / "captures.npz")
    with np.load(path) as archive:
        content = dict(archive)
    np.savez(path, **content | {"display_common_lens_coefficients": coefficients})
    with pytest.raises(BadInputError, match=r"'display_common_lens_\.\.\.' have shapes that do not fit"):
        load_captures(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"motion": np.zeros((3, 6, 2))}, r"'motion' must have shape \(3, 6, 3\)"),
        ({"capture": np.array([0, 1, 1])}, "'capture' has an index twice"),
        ({"sources": ()}, r"must have shape|must name one"),
        ({"lens": Polynomial(LENS.orders, LENS.box, np.zeros((6, 4)))}, "'lens' must have 2 variables and 6 outputs"),
        ({"focus": np.full((2, 3), np.nan)}, "'focus' has numbers that are not finite"),
    ],
)
def test_errors_that_do_not_fit_are_refused(change: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        dataclasses.replace(COMMON, **change)


def test_captures_of_which_they_leave_something_out_are_refused() -> None:
    few = dataclasses.replace(COMMON, capture=np.array([0, 1, 3]))
    with pytest.raises(BadInputError, match="no motion for capture 2; give one for every capture"):
        dataclasses.replace(SEE_THROUGH, common=few)
    other = dataclasses.replace(COMMON, target_pose=np.array([4, 8]))
    with pytest.raises(BadInputError, match="nothing for target pose 7; give one for every target pose"):
        dataclasses.replace(SEE_THROUGH, common=other)
    with pytest.raises(BadInputError, match="need the camera's rotation in every row"):
        dataclasses.replace(SEE_THROUGH, device_from_camera=np.full((3, 3), np.nan))


def test_both_parts_of_an_eye_must_share_the_same_variables() -> None:
    with pytest.raises(BadInputError, match="must have the same variables; give both the same 'sources'"):
        Captures(dataclasses.replace(DISPLAY, common=None), SEE_THROUGH)
