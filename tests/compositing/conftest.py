"""Compositors that are released when a test ends, and what is chosen for an eye before its first frame."""

import pickle
from functools import wraps

import pytest
from composing import SMALL

from wlr_render.compositing import gl_backend
from wlr_render.compositing.compositor import Compositor
from wlr_render.errors import MissingGlError
from wlr_render.rendering import raster_camera

CHOICES = (
    (raster_camera, "choose_warp_grid"),
    (raster_camera, "minification_over_eye_box"),
    (gl_backend, "choose_plan"),
)
"""Functions of a model alone, which solve thousands of its rays: the most part of a compositor's start."""

_CHOSEN = {}


def remembered(function):
    """Return the function with its answers kept for models that are equal, whoever made them."""

    @wraps(function)
    def with_memory(*given):
        key = function.__name__, pickle.dumps(given)
        if key not in _CHOSEN:
            _CHOSEN[key] = function(*given)
        return _CHOSEN[key]

    return with_memory


@pytest.fixture(autouse=True)
def choices_made_once(monkeypatch):
    """Choose for each model once in a run; tests/rendering hold the choices to their laws."""
    for module, name in CHOICES:
        monkeypatch.setattr(module, name, remembered(getattr(module, name)))


@pytest.fixture
def compositor(request):
    """Makes compositors, in the context of the test run and its programs unless a test names another one.

    Skips the test where the OpenGL that it wants does not open.
    """
    made = []

    def make(models, size=SMALL, context=None, **options):
        chosen = request.getfixturevalue("gl_context") if context is None else context
        try:
            made.append(Compositor(models, size, context=chosen, **options))
        except MissingGlError as error:
            pytest.skip(str(error))
        return made[-1]

    yield make
    for each in made:
        each.release()
