"""The paper's figure 5: results of planar and volumetric models along one ray, where they must not change."""

from functools import lru_cache

import numpy as np

from benchmarks.paper.figures import POSITIONS, field_directions
from benchmarks.trial_study import Lines
from benchmarks.trials import EvaluatedEye, capture_setup, truth
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import DisplayMapping, SeeThroughMapping
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Plot
from wlr_render.report.plots import curves
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

DEGREE = 5
KINDS = ("planar", "volumetric")
ALONG_MM = np.linspace(-4.0, 20.0, 49)
"""Positions on the ray behind the base plane; negative positions are nearer to the optics."""


@lru_cache
def failures(eyes: tuple[EvaluatedEye, ...]) -> tuple[Plot, ...]:
    """Plot errors of fitted models along one ray of a pixel (figure 5a), and along one view ray (5b)."""
    display: Lines = {}
    world: Lines = {}
    for eye in eyes:
        for kind in KINDS:
            name = f"{eye}, {kind}"
            shown, seen = fitted(eye, kind)
            display[name] = ALONG_MM.tolist(), display_error_along_ray(eye, shown).tolist()
            world[name] = ALONG_MM.tolist(), world_ray_error_along_ray(eye, seen).tolist()
    models = f"N={DEGREE}, {POSITIONS} exact captures"
    depths = ", ".join(dict.fromkeys(f"{eye.eye_box_mm[2]:g}" for eye in eyes))
    caption = (
        f"The exact direction is the same at every place of the ray. The eye box is {depths} mm deep, half of it on "
        "each side of zero. A planar model has one error for the whole ray, a volumetric one has another at each place."
    )
    axes = ("place on the ray behind the base plane (mm)", "error (arcmin)")
    titles = f"Figure 5a: one pixel along its ray, {models}", f"Figure 5b: one world ray along its view ray, {models}"
    return tuple(
        curves(title, lines, axes, log_y=True, grouped=True, caption=caption)
        for title, lines in zip(titles, (display, world), strict=True)
    )


def fitted(eye: EvaluatedEye, kind: str) -> tuple[DisplayMapping, SeeThroughMapping]:
    """Fit display and see-through models to exact captures."""
    setup, rng = capture_setup(eye), np.random.default_rng(0)
    position = setup.camera_positions(kind, POSITIONS)
    display = fit_display(simulate_display(setup, position, rng), kind, DEGREE)
    see_through = fit_see_through(simulate_see_through(setup, position, rng), kind, DEGREE)
    return display.mapping, see_through.mapping


def display_error_along_ray(eye: EvaluatedEye, model: DisplayMapping) -> FloatArray:
    """Return errors (n,) in arcminutes of the direction of one pixel, at positions `ALONG_MM` on one of its rays."""
    at, view_dir = truth(eye), _view_dir(eye)
    pixel = at.display.pixel_of_view_dir(view_dir, at.eye_box.centre).value
    return arcmin_between(model.view_dir_of_pixel(pixel, _places(eye)).value, view_dir)


def world_ray_error_along_ray(eye: EvaluatedEye, model: SeeThroughMapping) -> FloatArray:
    """Return errors (n,) in arcminutes of the direction of the world ray, at positions `ALONG_MM` on one view ray."""
    at, view_dir = truth(eye), _view_dir(eye)
    exact = at.see_through.real_ray_of_view_dir(view_dir, at.eye_box.centre).value[3:]
    return arcmin_between(model.real_ray_of_view_dir(view_dir, _places(eye)).value[:, 3:], exact)


def _view_dir(eye: EvaluatedEye) -> FloatArray:
    """Return the direction (3,) halfway between the middle and a corner of the field."""
    return np.asarray(field_directions(eye, 3, 3)[0])


def _places(eye: EvaluatedEye) -> FloatArray:
    view_dir = _view_dir(eye)
    return np.asarray(truth(eye).eye_box.centre - 1e-3 * ALONG_MM[:, None] / -view_dir[2] * view_dir)
