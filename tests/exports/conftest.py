"""Views that the tests of formats write."""

from dataclasses import replace

import numpy as np
import pytest
from small_headsets import LeftHalf

from wlr_render.exports.export_view import ExportedView
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions


@pytest.fixture(scope="session")
def northstar_view(small_northstar: str) -> ExportedView:
    """The right eye of a small headset, 180 x 200 pixels, exact optics, source camera at the pupil."""
    return views_from_centres(ExportOptions(small_northstar, format="stmap"))["right"]


@pytest.fixture
def view(northstar_view: ExportedView) -> ExportedView:
    """A copy, whose maps are its own."""
    return replace(northstar_view)


@pytest.fixture(scope="session")
def nearest_view(small_northstar: str) -> ExportedView:
    """The same with the source camera nearest to the rays."""
    return views_from_centres(ExportOptions(small_northstar, format="stmap", source_camera="nearest"))["right"]


@pytest.fixture
def near_view(northstar_view: ExportedView) -> ExportedView:
    """The same for points half a metre deep."""
    return replace(northstar_view, depth_m=0.5)


@pytest.fixture
def holed_view(view: ExportedView) -> ExportedView:
    """The same, with a panel pixel in row 5 and column 7 that has no ray."""
    rays = np.array(view.slope_offset("all"))
    rays[:, 5, 7] = np.nan
    holed = replace(view)
    holed.__dict__["_slope_offsets"] = (rays,)
    return holed


@pytest.fixture(scope="session")
def coloured_view(small_prism: str) -> ExportedView:
    """A prism whose glass has colours, traced in red, green and blue."""
    return views_from_centres(ExportOptions(small_prism, format="stmap", per_colour=True))["right"]


@pytest.fixture
def view_of_half_a_panel(straight_device: str) -> ExportedView:
    whole = views_from_centres(ExportOptions(straight_device, format="mesh"))["right"]
    (eye,) = whole.channels
    return replace(whole, channels=(replace(eye, display=LeftHalf(eye.display)),))
