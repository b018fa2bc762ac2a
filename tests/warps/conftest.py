"""Compositors that are released when a test ends.

A folder `warp` would hide that the library of this name is not installed: Python takes it for a package.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import moderngl
import pytest
from gl_caller import open_other
from warps.composing import SMALL, Make, planar, viewpoint

from wlr_render.errors import MissingGlError
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor


@pytest.fixture(autouse=True)
def choices_of_this_room(choices_made_once: None) -> None:
    """Every compositor starts with the choices that were made for its model."""


@pytest.fixture
def compositor(request: pytest.FixtureRequest) -> Iterator[Callable[..., Any]]:
    """Makes compositors, in the context of the test run and its programs unless a test names another one.

    Skips the test where the OpenGL that it wants does not open.
    """
    made = []

    def make(
        models: Eye | Mapping[str, Eye | Sequence[Eye]],
        size: tuple[int, int] = SMALL,
        context: moderngl.Context | str | None = None,
        **options: Any,
    ) -> Compositor:
        chosen = request.getfixturevalue("gl_context") if context is None else context
        try:
            made.append(Compositor(models, size, context=chosen, **options))
        except MissingGlError as error:
            pytest.skip(str(error))
        return made[-1]

    yield make
    for each in made:
        each.release()


@pytest.fixture
def made(compositor: Make, flat_image_headset: Eye) -> Compositor:
    """A compositor of the flat image headset."""
    one: Compositor = compositor(flat_image_headset)
    return one


@pytest.fixture
def seen(flat_image_headset: Eye) -> FloatArray:
    """A viewpoint of the flat image headset."""
    return viewpoint(flat_image_headset)


@pytest.fixture
def pair(flat_image_headset: Eye) -> dict[str, Eye]:
    return {"left": replace(flat_image_headset, eye="left"), "right": flat_image_headset}


@pytest.fixture(params=["planar", "flat image"])
def headset(request: pytest.FixtureRequest, flat_image_headset: Eye) -> Eye:
    return planar() if request.param == "planar" else flat_image_headset


@pytest.fixture
def theirs(gl_context: GlContext) -> Iterator[moderngl.Context]:
    """A caller's context; `gl_context` skips the test where there is no OpenGL."""
    other = open_other()
    yield other
    other.release()
