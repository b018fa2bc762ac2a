"""The configuration file of Monado's North Star driver: a grid of tangents for each eye."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView, has_ray
from wlr_render.exports.facts import facts
from wlr_render.exports.format import Capabilities, Format, Loss
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.atomic_files import write_text
from wlr_render.numerics.arrays import FloatArray

_POINTS = 65
"""Grid points along each side of the panel: the corners of the 64 cells of Monado's own mesh."""
_PANEL_PX = (1440, 1600)
"""Size of the window that the driver always opens for each eye."""
_EDGE_TO_EDGE = np.linspace(0.0, 1.0, _POINTS)
_EYES = ("left", "right")


class Monado(Format):
    """The format `monado`."""

    name = "monado"
    title = "distortion of Monado's North Star driver (JSON, meshgrid version 2)"
    holds = Capabilities(colours=False, pupils=False, asymmetric_field=False, every_pixel=False, both_eyes=True)
    convention = (
        f"left and right: a grid of {_POINTS} x {_POINTS} points over the panel from edge to edge, rows from the top; "
        "linear between points.",
        "A point has the tangents [x, y] of its ray as seen from the source camera, x to the right, y down.",
        "fov: borders of the source picture of each eye, [left, right, up, down] in radians; baseline: distance of the "
        "source cameras in mm.",
        "about: all else, by eye, in all digits. Monado does not read it.",
    )
    use = (
        "Build Monado with -DXRT_BUILD_DRIVER_NS=ON: packages of distributions may lack the driver.",
        "Start it with `NS_CONFIG_PATH=monado-northstar.json NS_LOG=info monado-service`. It must print: Using Moshi's "
        "meshgrid-based display distortion correction.",
        "Monado's head pose is the pose of the middle between the source cameras (head_in_device_m in about), with the "
        "axes of the device frame.",
    )

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Return the error in the middle of the grid's cells, where it is largest."""
        errors = _linear_errors(view, _tangents(view))
        return Loss("between the points of the grid", float(np.sqrt(np.mean(errors**2))), float(errors.max()))

    def files(self, view: ExportedView) -> list[str]:
        """Return the single file, which holds both eyes."""
        return ["monado-northstar.json"]

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write one file for both eyes.

        Raises:
            BadInputError: a panel other than the driver's, or grid points without a ray.
        """
        by_eye = {view.eye: view for view in views}
        places = np.stack([by_eye[eye].source.position_in_device for eye in _EYES])
        grids = {eye: _tangents(by_eye[eye]) for eye in _EYES}
        about = {eye: self._about(by_eye[eye], grids[eye], places) for eye in _EYES}
        camera = by_eye["left"].source.camera
        (name,) = self.files(by_eye["left"])
        yield write_text(folder / name, json.dumps(_config(grids, camera, places, about)) + "\n")

    def _about(self, view: ExportedView, grid: FloatArray, places: FloatArray) -> dict[str, Any]:
        """Return the facts of one eye, and the errors that this format adds."""
        head = places.mean(axis=0)
        placed = head + (places[1, 0] - places[0, 0]) * np.array([-0.5 if view.eye == "left" else 0.5, 0, 0])
        camera = view.source.camera
        used = np.ptp(grid, axis=(0, 1)) / (camera.tangent_max - camera.tangent_min)
        return facts(view, view.middle_colour, self) | {
            "head_in_device_m": head.tolist(),
            "source_camera_from_where_monado_places_it_m": (view.source.position_in_device - placed).tolist(),
            "used_share_of_the_source_picture": {"width": float(used[0]), "height": float(used[1])},
            "linear_between_points_max_arcmin": float(_linear_errors(view, grid).max()),
        }


def _tangents(view: ExportedView, columns: FloatArray = _EDGE_TO_EDGE, rows: FloatArray = _EDGE_TO_EDGE) -> FloatArray:
    """Return the tangents (rows, columns, 2), x right, y up, from the source camera, of panel positions from 0 to 1.

    Raises:
        BadInputError: a panel other than the driver's, or positions without a ray.
    """
    if view.panel_size_px != _PANEL_PX:
        width, height = view.panel_size_px
        raise BadInputError(
            f"monado: the North Star driver shows {_PANEL_PX[0]} x {_PANEL_PX[1]} pixels for each eye, and the panel "
            f"of {view.origin.name} has {width} x {height}; choose another format, e.g. mesh."
        )
    pixel = np.stack(np.meshgrid(columns, rows), axis=-1) * _PANEL_PX
    tangents = view.tangents(np.moveaxis(view.rays_at(view.middle_colour, pixel), -1, 0))
    lost = ~has_ray(tangents)
    if lost.any():
        raise BadInputError(
            f"monado: {np.mean(lost):.1%} of the {view.eye} panel of {view.origin.name} has no ray, and Monado's grid "
            "has no mark for that; choose another format, e.g. mesh."
        )
    return tangents


def _linear_errors(view: ExportedView, grid: FloatArray) -> FloatArray:
    """Return the errors in arcmin of bilinear interpolation at the centres of the grid's cells."""
    middle = (np.arange(_POINTS - 1) + 0.5) / (_POINTS - 1)
    bilinear = 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])
    exact = _tangents(view, middle, middle)
    return arcmin_between(dir_of_tangents(bilinear), dir_of_tangents(exact))


def _config(
    grids: dict[str, FloatArray], camera: Pinhole, places: FloatArray, about: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    # The driver takes y as the downward tangent only for a picture that is symmetric up and down, so this picture
    # always is.
    (left, down), (right, up) = np.arctan([camera.tangent_min, camera.tangent_max]).tolist()
    return {
        "type": "meshgrid",
        "version": 2,
        "num_grid_points_x": _POINTS,
        "num_grid_points_y": _POINTS,
        "baseline": 1e3 * float(places[1, 0] - places[0, 0]),
        "fov": [left, right, up, down],
        **{eye: {"grid": (grid * [1, -1]).tolist()} for eye, grid in grids.items()},
        "about": about,
    }
