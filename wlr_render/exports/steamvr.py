"""The optics in SteamVR's JSON file of a headset: a radial distortion for each eye and colour."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView, has_ray
from wlr_render.exports.facts import facts
from wlr_render.exports.format import Capabilities, Format, Loss
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents, tangents_of_dir
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.io.atomic_files import write_text
from wlr_render.numerics.arrays import FloatArray

_POINTS = 25  # points along each side of the panel at which the distortion is fitted
_KEYS = {"red": "distortion_red", "green": "distortion", "blue": "distortion_blue"}
_COMMON, _OF_COLOUR = 5, 5  # unknowns: focal lengths and rotation vector; per colour, centre and coefficients


@dataclass(frozen=True, eq=False)
class _Fit:
    """Fitted optics of one eye.

    Attributes:
        focal: (2,) focal lengths of the intrinsics.
        device_from_lens: (3, 3) rotation of the lens's axis.
        centre, k: (colours, 2), (colours, 3) centres and coefficients of the distortion.
        errors_arcmin: (colours, points) angles between the fitted and the exact directions.
    """

    focal: FloatArray
    device_from_lens: FloatArray
    centre: FloatArray
    k: FloatArray
    errors_arcmin: FloatArray


class SteamVr(Format):
    """The format `steamvr`."""

    name = "steamvr"
    title = "optics of SteamVR's JSON file of a headset (DISTORT_DPOLY3), which Monado reads too"
    holds = Capabilities(pupils=False, every_pixel=False, both_eyes=True)
    convention = (
        "tracking_to_eye_transform: the left, then the right eye. A panel position (u, v) from the top left corner is "
        "q = (2 u / width - 1, (2 v / height - 1) / aspect), with aspect = physical_aspect_x_over_y.",
        "A colour shows (x, y) = center + (q - center) / (1 + c0 r^2 + c1 r^4 + c2 r^6), with r the distance of q from "
        "center and c its coeffs; distortion is that of green.",
        "Tangents to the right and up, in the axes of eye_to_head, are (x + cx) / fx and (cy - aspect y) / fy; "
        "intrinsics are [[fx, 0, cx], [0, fy, cy], [0, 0, -1]].",
        "lens_separation: distance of the pupils to the left and right in metres. about: all else, by eye.",
    )
    use = (
        "Copy the keys device, lens_separation and tracking_to_eye_transform into the headset's own JSON file, which "
        "lighthouse_console reads from it and writes into it. This has not been tried on a headset.",
    )

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Return the error of the radial distortion, over a grid of panel positions."""
        errors = _fitted(view).errors_arcmin[view.colours.index(colour)]
        return Loss("radial distortion", float(np.sqrt(np.mean(errors**2))), float(errors.max()))

    def files(self, view: ExportedView) -> list[str]:
        """Return the single file, which holds both eyes and all colours."""
        return ["steamvr.json"]

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write one file for both eyes.

        Raises:
            BadInputError: no radial distortion can be fitted, because most pixels have no ray.
        """
        left, right = sorted(views, key=lambda view: view.eye)
        apart = right.source.position_in_device[0] - left.source.position_in_device[0]
        width, height = left.panel_size_px
        content = {
            "device": {
                "eye_target_width_in_pixels": width,
                "eye_target_height_in_pixels": height,
                "physical_aspect_x_over_y": width / height,
            },
            "lens_separation": float(apart),
            "tracking_to_eye_transform": [self._eye(view) for view in (left, right)],
            "about": {view.eye: facts(view, view.middle_colour, self) for view in (left, right)},
        }
        (name,) = self.files(left)
        yield write_text(folder / name, json.dumps(content) + "\n")

    def _eye(self, view: ExportedView) -> dict[str, Any]:
        fit = _fitted(view)
        aspect = view.panel_size_px[0] / view.panel_size_px[1]
        (fx, fy), (cx, cy) = fit.focal.tolist(), fit.centre[len(fit.centre) // 2].tolist()
        distortions = {}
        for number, key in enumerate(_KEYS.values()):
            colour = number if len(fit.k) > 1 else 0
            x, y = fit.centre[colour].tolist()
            coeffs = [*fit.k[colour].tolist(), *[0.0] * 5]
            distortions[key] = {"type": "DISTORT_DPOLY3", "center_x": x, "center_y": y, "coeffs": coeffs}
        return distortions | {
            "intrinsics": [[fx, 0.0, -cx], [0.0, fy, aspect * cy], [0.0, 0.0, -1.0]],
            "eye_to_head": fit.device_from_lens.tolist(),
            "grow_for_undistort": 0.6,
            "undistort_r2_cutoff": 1.0 + 1.0 / aspect**2,
        }


def _fitted(view: ExportedView) -> _Fit:
    """Fit lens axis, focal lengths and a distortion of each colour, by least squares of tangents.

    Raises:
        BadInputError: fewer than half of the points have a ray.
    """
    size = np.array(view.panel_size_px, np.float64)
    unit = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, _POINTS)] * 2), axis=-1).reshape(-1, 2)
    rays = np.stack([view.rays_at(colour, 0.5 * (unit + 1.0) * size) for colour in view.colours])
    exact = view.tangents(np.moveaxis(rays, -1, 0))  # (colours, points, 2)
    kept = has_ray(exact).all(axis=0)
    if kept.mean() < 0.5:
        raise BadInputError(
            f"steamvr: most of the {view.eye} panel of {view.origin.name} has no ray; choose another format, e.g. mesh."
        )
    aspect = size[0] / size[1]
    panel, exact = (unit / [1.0, aspect])[kept], exact[:, kept]
    view_dir = dir_of_tangents(exact)
    slope = np.ptp(panel * [1.0, aspect], axis=0) / np.ptp(exact[len(exact) // 2], axis=0)
    start = np.concatenate([slope, np.zeros(_COMMON - 2 + _OF_COLOUR * len(exact))])

    def in_lens(unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
        focal, lens = unknown[:2], rotations_of_vectors(unknown[2:_COMMON])
        of_colour = unknown[_COMMON:].reshape(len(exact), 1, _OF_COLOUR)
        centre, (k1, k2, k3) = of_colour[..., :2], np.moveaxis(of_colour[..., 2:, None], 2, 0)
        offset = panel - centre
        r2 = np.sum(offset**2, axis=-1, keepdims=True)
        shown = centre + offset / (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) - centre[len(exact) // 2]
        return shown * [1.0, -aspect] / focal, tangents_of_dir(view_dir @ lens)

    def residual(unknown: FloatArray) -> FloatArray:
        shown, wanted = in_lens(unknown)
        return np.asarray((shown - wanted).ravel())

    found = scipy.optimize.least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    shown, wanted = in_lens(found)
    of_colour = found[_COMMON:].reshape(len(exact), _OF_COLOUR)
    return _Fit(
        found[:2],
        view.source.device_from_camera @ rotations_of_vectors(found[2:_COMMON]),
        of_colour[:, :2],
        of_colour[:, 2:],
        arcmin_between(dir_of_tangents(shown), dir_of_tangents(wanted)),
    )
