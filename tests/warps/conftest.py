"""Compositors that are released when a test ends.

A folder `warp` would hide that the library of this name is not installed: Python takes it for a package.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import moderngl
import pytest
from warps.composing import SMALL

from wlr_render.errors import MissingGlError
from wlr_render.mappings import Eye
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
