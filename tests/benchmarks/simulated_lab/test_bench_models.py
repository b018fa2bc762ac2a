"""The frame in which models of a simulated bench are judged."""

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.simulated_lab.bench_models import true_to_found
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.simulation.photographs.camera import SimulatedLens


def test_a_lens_with_its_centre_elsewhere_sees_the_world_turned() -> None:
    true = LensCamera((1600, 1200), np.full(2, 1110.0), np.array([800.0, 600.0]))
    found = LensCamera((1600, 1200), np.full(2, 1110.0), np.array([795.0, 600.0]))
    # A centre that is 5 px further left sees each pixel further right: directions turn about y, by 5 / 1110 at the
    # centre and by less at the edges of the field.
    turn = Rotation.from_matrix(true_to_found(found, SimulatedLens(true))[:3, :3]).as_rotvec()
    np.testing.assert_allclose(turn[[0, 2]], 0.0, atol=1e-5)
    assert 0.7 * 5.0 / 1110.0 < turn[1] < 5.0 / 1110.0
    np.testing.assert_allclose(true_to_found(true, SimulatedLens(true)), np.eye(4), atol=1e-12)
