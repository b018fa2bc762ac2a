"""Views that the tests of formats write."""

from dataclasses import replace

import pytest

from wlr_render.jobs.export import ExportOptions, first_view


@pytest.fixture(scope="session")
def northstar_view(small_northstar):
    """The right eye of a small headset, 180 x 200 pixels, exact optics, source camera at the pupil."""
    return first_view(ExportOptions("stmap", small_northstar), "right")


@pytest.fixture
def view(northstar_view):
    """A copy, whose maps are its own."""
    return replace(northstar_view)
