"""Tables of see-through maps: a position that saw one depth only has no map for near and far points."""

import numpy as np
import pytest
from rival_headsets import IN_PLANE, rms, see_through_captures

from benchmarks.rivals.map_tables import linear_table
from benchmarks.rivals.samples import fit_structure
from wlr_render.calibration.fit_see_through import SEE_THROUGH
from wlr_render.captures.correspondences import select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN


def bent(point, viewpoint):
    """A wedge that grows across the eye box, and an offset of 1 mm."""
    depth = viewpoint[:, 2:] - point[:, 2:]
    straight = (point[:, :2] - viewpoint[:, :2]) / depth
    return straight + 1e-3 * (1 + 20 * viewpoint[:, :1]) * straight + 1e-3 / depth


def test_two_depths_are_enough():
    captures = see_through_captures(IN_PLANE, bent)
    model, _ = fit_structure(SEE_THROUGH, captures, "planar", linear_table)
    seen = model.view_dir_of_real_point(captures.point, captures.viewpoint).value
    assert rms(np.linalg.norm(seen - captures.view_dir, axis=1) / ARCMIN) < 0.3


def test_one_depth_at_any_position_is_refused():
    captures = see_through_captures(IN_PLANE, bent)
    near_only = (captures.capture == 7) & (captures.target_pose == 1)
    with pytest.raises(BadInputError, match=r"camera position 7 saw real points from 0\.40 to 0\.40 m only"):
        fit_structure(SEE_THROUGH, select(captures, ~near_only), "volumetric", linear_table)
