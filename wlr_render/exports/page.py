"""A fitted headset as one HTML page: move the pupil and turn the head, and compare three ways to draw."""

import base64
import gzip
import itertools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render import __version__
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.exports.c_model import model_bytes
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.format import Capabilities, Format
from wlr_render.exports.mesh import TOLERANCE_ARCMIN
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.atomic_files import resource, write_text
from wlr_render.io.escapes import html_text
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.choose_grid import choose_mesh_grid

TEMPLATE = "page.html"
_DATA = "DATA_OF_THE_PAGE"
SCENE = "desk"
MOST_PX = 800
"""Largest width or height of the panel's picture that software renderers draw several times a second."""
_MOST_TURN_DEG = 8.0
_NEAREST_M = 0.3
"""Distance of the nearest surface of the scene, at least."""
_MAP_CELLS = 12
"""Numbers of cells of the maps across and down."""
_NAIVE_POINTS = 17
_EYE_NODES = 13
_BORDER_POINTS = 9
"""Points along each side of a picture whose rays the scene's picture must contain."""


class Page(Format):
    """The format `page`."""

    name = "page"
    title = "HTML page for a browser: move pupil and head, compare three ways to draw"
    holds = Capabilities(every_depth=True, every_pupil=True, colours=False)
    endings = ("-page.html",)
    convention = (
        "NAME-page.html: a simulation of the fitted headset in WebGL 2. It needs no network and no other file.",
        f"It has the model as in the format c, and a picture of the scene '{SCENE}' with its depth, as seen from "
        "the centre of the eye box. shaders/own_warp.glsl, the warp for other programs, draws the panel and the eye's "
        "view of the scene.",
        "Misalignment is the angle between a panel pixel and the real point that it shows, 1 m away, both seen through "
        "the fitted models, which are the truth of the page. The predicted error states the errors that the "
        "calibration left.",
    )
    use = (
        "Open NAME-page.html in a browser.",
        "Drag the pupil in the eye box, or select the box and press the arrow keys. Drag the picture to turn the head.",
        "Choose how the panel is drawn: 1 naive, 2 static, 3 planar.",
    )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        template = Path(__file__).with_name(TEMPLATE).read_text(encoding="utf-8")
        text = json.dumps(page_data(view, colour), allow_nan=False).replace("<", "\\u003c")
        yield write_text(paths[0], template.replace(_DATA, text))


def page_data(view: ExportedView, colour: str) -> dict[str, Any]:
    """Return the model, the picture and the texts of a page, plain JSON.

    Raises:
        BadInputError: the headset is not a fitted planar model.
    """
    content = model_bytes(view, colour)
    eye, axes = view.mappings(colour), view.source.device_from_camera
    scale = min(1.0, MOST_PX / max(view.panel_size_px))
    width_px, height_px = (max(1, round(scale * size)) for size in view.panel_size_px)
    panel_px = width_px, height_px
    grid = choose_mesh_grid(eye, axes, panel_px, TOLERANCE_ARCMIN)
    seen, naive = _eye_camera(eye, height_px), _flat_picture(eye)
    camera = _picture_camera(view, _drawn_rays(eye, seen, naive), scale)
    picture, inverse_depth = _picture(view, camera)
    nearest = max(float(inverse_depth.max()), 1e-3)
    steps = np.round(inverse_depth / nearest * 65535).astype(np.uint16)
    bits = np.stack([steps & 255, steps >> 8]).astype(np.uint8)
    name, side = html_text(view.origin.name), view.eye
    return {
        "title": f"{name}, {side} eye: a simulation in the browser",
        "verdict": f"This page is a simulation of the {side} eye of {name}. It takes the fitted models as the truth, "
        "so planar has interpolation errors only. The predicted error states the errors that the calibration left.",
        "about": f"wlr_render {__version__}, export --format page. Scene: {SCENE}.",
        "model": _base64(content),
        "shader": resource("shaders", "own_warp.glsl").read_text(encoding="utf-8"),
        "panel_px": panel_px,
        "step_px": max(1, int(np.min(np.divide(panel_px, np.subtract(grid.size, 1))))),
        "nodes": view.plans[view.colours.index(colour)].node_count,
        "map": [_MAP_CELLS, _MAP_CELLS],
        "naive": naive.T.tolist(),
        "eye_px": seen.size_px,
        "eye_nodes": _EYE_NODES,
        "eye_borders": _borders(seen),
        "picture": _base64(cv2.imencode(".png", picture[..., ::-1])[1].tobytes()),
        "picture_px": camera.size_px,
        "picture_borders": _borders(camera),
        "picture_at": view.source.position_in_device.tolist(),
        "inverse_depth": _base64(gzip.compress(bits.tobytes(), mtime=0)),
        "nearest": nearest,
        "most_turn": float(np.deg2rad(_MOST_TURN_DEG)),
    }


def _flat_picture(eye: Eye) -> FloatArray:
    """Return the naive method's view tangents as a linear function (3, 2) of (1, x, y), panel positions from 0 to 1.

    It is the best fit at the centre of the eye box, as in the demo.
    """
    pixel = eye.display.panel.grid(_NAIVE_POINTS, _NAIVE_POINTS).reshape(-1, 2)
    shown = eye.display.view_dir_of_pixel(pixel, eye.eye_box.centre)
    terms = np.column_stack([np.ones(len(pixel)), pixel / eye.display.panel.size_px])
    coefficients, *_ = np.linalg.lstsq(terms[shown.usable], directions.tangents_of_dir(shown.value[shown.usable]))
    return np.asarray(coefficients)


def _eye_camera(eye: Eye, height_px: int) -> Pinhole:
    """Return the camera of the eye's view: it contains the panel from the centre of the eye box."""
    edge = eye.display.view_dir_of_pixel(eye.display.panel.grid(9, 9).reshape(-1, 2), eye.eye_box.centre)
    tangents = directions.tangents_of_dir(edge.value[edge.usable])
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    width_px = round(height_px * float(np.divide(*(high - low))))
    return Pinhole(min(width_px, 2 * height_px), height_px, low, high)


def _drawn_rays(eye: Eye, seen: Pinhole, naive: FloatArray) -> FloatArray:
    """Return points and directions (n, 6) of the rays at the borders of both pictures, by all methods and pupils."""
    along = np.linspace(0.0, 1.0, _BORDER_POINTS)
    border = np.array([each for each in itertools.product(along, repeat=2) if not {0.0, 1.0}.isdisjoint(each)])
    looked = directions.dir_of_tangents(seen.tangent_min + border * (seen.tangent_max - seen.tangent_min))
    flat = directions.dir_of_tangents(np.insert(border, 0, 1.0, axis=1) @ naive)
    still = _panel_rays(eye, border, eye.eye_box.centre)
    rays = []
    for viewpoint in eye.eye_box.at(np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))):
        static = still + np.concatenate([viewpoint - eye.eye_box.centre, np.zeros(3)])
        through = eye.see_through.real_ray_of_view_dir(looked, viewpoint).value
        past = np.hstack([np.broadcast_to(viewpoint, flat.shape), flat])
        rays += [_panel_rays(eye, border, viewpoint), static, past, through]
    return np.concatenate(rays)


def _panel_rays(eye: Eye, place: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the world rays (n, 6) behind panel positions (n, 2) from 0 to 1."""
    shown = eye.display.view_dir_of_pixel(place * eye.display.panel.size_px, viewpoint).value
    return eye.see_through.real_ray_of_view_dir(shown, viewpoint).value


def _picture_camera(view: ExportedView, rays: FloatArray, scale: float) -> Pinhole:
    """Return the camera of the scene's picture: it contains what rays (n, 6) meet at the largest turns of the head."""
    most, axes = np.deg2rad(_MOST_TURN_DEG), view.source.device_from_camera
    nearest = rays[:, :3] + _NEAREST_M * rays[:, 3:]
    tangents = []
    for yaw, pitch in itertools.product((-most, 0.0, most), repeat=2):
        turn = transforms.rotation_about("y", yaw) @ transforms.rotation_about("x", pitch)
        for towards in (nearest @ turn.T - view.source.position_in_device, rays[:, 3:] @ turn.T):
            tangents.append(directions.tangents_of_dir(towards @ axes))
    return Pinhole.covering(np.concatenate(tangents), scale * float(view.source.camera.focal_px.mean()))


def _picture(view: ExportedView, camera: Pinhole) -> tuple[NDArray[np.uint8], FloatArray]:
    """Return the scene's picture (height, width, 3) and inverse depths (height, width), 1/m, for a head at rest."""
    axes, at = view.source.device_from_camera, view.source.position_in_device
    renderer = RayRenderer(load_scene(SCENE))
    towards = directions.dir_of_tangents(camera.pixel_centre_tangents()) @ axes.T
    image = renderer.render_rays(at, towards, shadows=True)
    # Directions have unit length: the depth along the camera's axis is shorter.
    depth = image.distance * -(towards @ axes)[..., 2]
    return image.colour, np.where(np.isfinite(depth), 1.0 / depth, 0.0)


def _borders(camera: Pinhole) -> list[float]:
    """Return the tangents of the left, right, bottom and top borders."""
    return np.stack([camera.tangent_min, camera.tangent_max], axis=1).ravel().tolist()


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
