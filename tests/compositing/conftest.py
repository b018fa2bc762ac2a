"""Compositors that are released when a test ends."""

import pytest
from composing import SMALL

from wlr_render.compositing.compositor import Compositor
from wlr_render.errors import MissingGlError


@pytest.fixture
def compositor():
    """Makes compositors; skips the test where the OpenGL that it wants does not open."""
    made = []

    def make(models, size=SMALL, **options):
        try:
            made.append(Compositor(models, size, **options))
        except MissingGlError as error:
            pytest.skip(str(error))
        return made[-1]

    yield make
    for each in made:
        each.release()
