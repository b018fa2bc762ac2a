import numpy as np
from present import as_number, narrowed

from benchmarks.paper.drawings import display_path, optics_of, see_through_path
from benchmarks.paper.figures import (
    MOVES_MM,
    field_directions,
    pupil_swim,
)
from benchmarks.trials import EvaluatedEye, truth
from wlr_render.geometry import rays
from wlr_render.geometry.directions import arcmin_between
from wlr_render.report.blocks import Plot, ReportTable

BOX = (10.0, 8.0, 6.0)
NORTHSTAR, BIRDBATH = (EvaluatedEye(name, "right", BOX, name=name) for name in ("northstar", "birdbath28"))


def test_paths_are_the_rays_of_the_mappings() -> None:
    eye, optics = truth(NORTHSTAR), optics_of(NORTHSTAR)
    view_dir = field_directions(NORTHSTAR, 3, 2)
    viewpoint = eye.eye_box.at(np.random.default_rng(2).uniform(-1, 1, (6, 3)))
    shown = display_path(optics, viewpoint, view_dir)
    pixel = eye.display.pixel_of_view_dir(view_dir, viewpoint).value
    np.testing.assert_allclose(shown[:, 0], optics.panel.point_of_pixel(pixel), atol=1e-12)
    np.testing.assert_array_equal(shown[:, -1], viewpoint)
    point, normal = np.array([0.0, 0.1, -0.3]), np.array([0.1, 0.2, 0.97])
    world = see_through_path(optics, viewpoint, view_dir, (point, normal))
    real = eye.see_through.real_ray_of_view_dir(view_dir, viewpoint).value
    np.testing.assert_allclose(rays.distance_to_point(real, world[:, -1]), 0.0, atol=1e-12)
    np.testing.assert_allclose((world[:, -1] - point) @ normal, 0.0, atol=1e-12)


def test_pupil_swim_is_the_change_of_exact_directions() -> None:
    table, display, _ = pupil_swim((BIRDBATH,))
    assert isinstance(table, ReportTable)
    assert [row[1] for row in table.rows] == list(MOVES_MM)
    assert len(narrowed(display, Plot).layout["updatemenus"][0]["buttons"]) == len(MOVES_MM)
    eye, view_dir = truth(BIRDBATH), field_directions(BIRDBATH, 11, 9)
    pixel = eye.display.pixel_of_view_dir(view_dir, eye.eye_box.centre).value
    moved = eye.display.view_dir_of_pixel(pixel, eye.eye_box.centre + [0.0, 0.0, 0.003]).value
    change = arcmin_between(view_dir, moved)
    np.testing.assert_allclose(
        [as_number(cell) for cell in table.rows[2][2:4]], [np.sqrt(np.nanmean(change**2)), np.nanmax(change)], rtol=1e-3
    )
