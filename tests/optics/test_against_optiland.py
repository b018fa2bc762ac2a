"""Our tracer against Optiland 0.6.3, an independent one: against its stored rays always, live where it is installed.

What Optiland cannot hold is held by laws elsewhere: the true offset of an ellipsoid (northstar's inner surface: exact
distances in test_optics_shapes) and the biconic under one root (the prism's S1 and S2: equation and normals there,
the patent's figures in test_traced_mappings).
"""

import numpy as np
import pytest
from optics.make_optiland_rays import STORED, WAVELENGTH_UM, cases, trace_with_optiland

from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Path
from wlr_render.optics.tracer import trace

CASES = cases()


def assert_same_rays(path: Path, rays: FloatArray) -> None:
    """Stored as (n, 2 + steps + 1, 3): origin, direction, points, last direction; to 1e-9 mm and 1e-9 rad."""
    traced = trace(path, rays[:, 0], rays[:, 1], WAVELENGTH_UM)
    assert (traced.status == Status.OK).all()
    np.testing.assert_allclose(traced.points, rays[:, 2:-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(traced.direction, rays[:, -1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_stored_rays(name: str) -> None:
    with np.load(STORED) as stored:
        assert_same_rays(CASES[name][0], stored[name])


@pytest.mark.oracle
@pytest.mark.parametrize("name", CASES)
def test_live(name: str) -> None:
    pytest.importorskip("optiland", reason="Optiland is not installed: pip install '.[oracle]'")
    path, origin, direction = CASES[name]
    rays = np.concatenate([origin[:, None], direction[:, None], trace_with_optiland(path, origin, direction)], axis=1)
    assert_same_rays(path, rays)
