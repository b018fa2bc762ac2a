"""A workload that takes milliseconds."""

import numpy as np
import pytest

from benchmarks.speed.workload import Workload, bench_scene
from wlr_render.errors import MissingGlError
from wlr_render.gl import gl
from wlr_render.mappings import Eye

ROUNDS = 2
TRIANGLES = 2000


def small_work(mappings: Eye) -> Workload:
    """The right eye alone."""
    places = np.random.default_rng(1).uniform(-0.9, 0.9, (ROUNDS + 1, 3))
    return Workload({"right": mappings}, bench_scene(TRIANGLES), places)


def needs_gl() -> None:
    """Skip where there is no OpenGL."""
    try:
        gl.open_context().release()
    except MissingGlError as error:
        pytest.skip(str(error))
