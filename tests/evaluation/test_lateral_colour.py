"""Colour of closed-form headsets, and of traced ones by what their glass does."""

from dataclasses import replace

import numpy as np
import pytest
from flat_image import FlatImage, PrismPlate
from present import as_number, narrowed

from wlr_render.evaluation.lateral_colour import DEPTH_M, lateral_colour, lateral_colour_table
from wlr_render.geometry import directions
from wlr_render.mappings import Eye
from wlr_render.optics.device_file import load_device
from wlr_render.optics.glass_files import shipped_glasses
from wlr_render.optics.traced_mappings import traced_eye

PIXEL = np.array([[70.0, 50.0], [20.0, 80.0], [130.0, 10.0]])


def test_a_chromatic_prism_deviates_real_points_but_not_pixels(flat_image_headset: Eye) -> None:
    """Two prisms that differ by 1e-3 in tangents, in a plate 30 mm before the eye."""
    green, eye = flat_image_headset, flat_image_headset.eye_box.centre
    plate = narrowed(green.see_through, PrismPlate)
    red = replace(green, see_through=replace(plate, prism=plate.prism + 1e-3))
    found = lateral_colour(green, red, eye, PIXEL)
    np.testing.assert_array_equal(found["display"], 0)
    behind_plate = DEPTH_M - (eye[2] - plate.z_m)
    tangents = directions.tangents_of_dir(green.display.view_dir_of_pixel(PIXEL, eye).value)
    shift = [behind_plate * 1e-3 / (DEPTH_M + plate.offset_m), 0.0]
    turned = directions.arcmin_between(
        directions.dir_of_tangents(tangents), directions.dir_of_tangents(tangents - shift)
    )
    np.testing.assert_allclose(found["see-through"], turned, rtol=1e-6)
    # The rays reach two metres behind each other's places by as much; the offset in the plate is the small rest.
    np.testing.assert_allclose(found["world ray"], turned, rtol=0.01)


def test_a_display_of_colour_is_seen_and_leads_elsewhere_in_the_world(flat_image_headset: Eye) -> None:
    green, eye = flat_image_headset, flat_image_headset.eye_box.centre
    red = replace(green, display=replace(narrowed(green.display, FlatImage), distance_m=2.5))
    found = lateral_colour(green, red, eye, PIXEL)
    seen = [each.display.view_dir_of_pixel(PIXEL, eye).value for each in (green, red)]
    np.testing.assert_array_equal(found["display"], directions.arcmin_between(*seen))
    np.testing.assert_allclose(found["see-through"], 0, atol=1e-9)
    assert found["display"].max() > 100
    np.testing.assert_allclose(found["world ray"], found["display"], rtol=0.02)


@pytest.mark.parametrize("name", ["northstar", "freeform40"])
def test_a_front_mirror_has_no_colour_and_the_combiner_that_of_its_plastic(name: str) -> None:
    """To first order in the indices' difference, 1 % of n - 1, a combiner's colour is in proportion to it."""
    red, green, blue = (traced_eye(load_device(name), "right", line) for line in (0.62, 0.53, 0.46))
    pixel = green.display.panel.grid(5, 4).reshape(-1, 2)
    index = shipped_glasses()["pmma_sultanova_2009"].index
    to_red, to_blue = (lateral_colour(green, other, green.eye_box.centre, pixel) for other in (red, blue))
    assert max(to_red["display"].max(), to_blue["display"].max()) < 1e-6
    ratio = (index(0.46) - index(0.53)) / (index(0.53) - index(0.62))
    np.testing.assert_allclose(to_blue["see-through"], ratio * to_red["see-through"], rtol=0.02)
    np.testing.assert_allclose(to_blue["world ray"], ratio * to_red["world ray"], rtol=0.02)
    assert to_red["see-through"].min() > 0.01


def test_the_table_has_rms_and_largest_of_each_colour(flat_image_headset: Eye) -> None:
    green = flat_image_headset
    plate = narrowed(green.see_through, PrismPlate)
    red = replace(green, see_through=replace(plate, prism=plate.prism + 1e-3))
    table = lateral_colour_table((red, green, green))
    to_red, to_blue = table.rows
    assert to_red[:2] == ["flat image", "red"]
    assert to_red[2:4] == [0, 0]
    assert 2.5 < as_number(to_red[4]) < as_number(to_red[5]) < 3.6
    assert max(map(as_number, to_blue[2:])) == 0
