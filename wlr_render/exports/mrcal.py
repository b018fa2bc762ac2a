"""mrcal's camera model with splines: the panel as the picture of a camera at the pupil, for photogrammetry."""

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView, has_ray
from wlr_render.exports.facts import facts, header_texts
from wlr_render.exports.format import Capabilities, Format, Loss
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.io.atomic_files import write_text
from wlr_render.lenses.splined_lens import SplinedLens
from wlr_render.numerics.arrays import FloatArray

_COLUMNS = (12, 16, 20, 26, 32)
"""Numbers of control points across the field of view, tried in this order."""
_WANTED_PX = 0.001
"""Target rms error at pixels that were not fitted; the first number of control points that reaches it is used."""
_REFUSED_PX = 0.1
"""Largest rms error; above it the pixels are not a continuous function of the direction: they fold or step."""
_FITTED, _HELD_OUT = 97, 60
"""Numbers of panel positions along each side, for the fit and for its validation."""
_FEWEST = 100
"""Fewest rays for a fit: 1 % of the positions."""
_SMOOTHING = 1e-5
"""Weight of the control points' third differences: small enough to affect only control points that no ray reaches."""
_CENTRE_SHIFT = 0.5
"""Our pixel position minus mrcal's, in which (0, 0) is the centre of the first pixel."""
_WIDEST_DEG = 300


class Mrcal(Format):
    """The format `mrcal`."""

    name = "mrcal"
    title = "camera model with splines (.cameramodel) for mrcal"
    holds = Capabilities(every_pixel=False)
    endings = (".cameramodel",)
    convention = (
        "The model projects a direction, seen from the source camera's position, to the panel pixel that shows it: "
        "LENSMODEL_SPLINED_STEREOGRAPHIC.",
        "Pixels are mrcal's: (0, 0) is the centre of the top left pixel. The camera's axes too: x right, y down, z "
        "forward.",
        "extrinsics (rt_fromref): from the device frame to the camera. Lengths are metres.",
        "The comments at the top of a file have the headset, eye, viewpoint, depth, source camera and these sentences.",
    )
    use = (
        "`model = mrcal.cameramodel('NAME.cameramodel')`; `mrcal.project(directions, *model.intrinsics())` gives panel "
        "pixels, `mrcal.unproject` the directions of pixels.",
        "As a warp: `mrcal.unproject(pixels, *model.intrinsics())` gives the direction (x, y, z) of each panel pixel "
        "in mrcal's axes; the source picture is read at the tangents tx = x / z and ty = -y / z.",
        "As a projection: with `extrinsics` mrcal projects points of the device frame to the pixels that show them.",
    )

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Return the error of the splines at pixels that were not fitted."""
        _, errors_px = _fitted_camera(view, colour)
        middle = 0.5 * np.array(view.panel_size_px) + np.array([[0.0, 0.0], [1.0, 0.0]])
        ray, neighbour = dir_of_tangents(view.tangents(np.moveaxis(view.rays_at(colour, middle), -1, 0)))
        arcmin = errors_px * float(arcmin_between(ray, neighbour))
        return Loss("error of the splines, in the middle's pixels", _rms(arcmin), float(arcmin.max()))

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        """Write a model; yield its path.

        Raises:
            BadInputError: no rays, or pixels that are not a continuous function of the direction.
        """
        texts = header_texts(facts(view, colour, self))
        yield write_text(paths[0], _cameramodel(view, _fitted_camera(view, colour), texts))


def _intervals_per_unit(field_x_deg: float, columns: int) -> float:
    """Return mrcal's knots per unit: they span the field of view and, for cubic splines, an interval on either side."""
    return float((columns - 3) / (4 * np.tan(np.radians(field_x_deg) / 4)))


def _spline_weights(u: FloatArray, field_x_deg: float, shape: tuple[int, int]) -> "scipy.sparse.csr_array":
    """Return the weights (n, control points) of the uniform cubic B-spline at stereographic coordinates (n, 2)."""
    index = u * _intervals_per_unit(field_x_deg, shape[0]) + 0.5 * (np.array(shape) - 1)
    knots = tuple(np.arange(count + 4) - 2.0 for count in reversed(shape))
    weights = scipy.interpolate.NdBSpline.design_matrix(np.ascontiguousarray(index[:, ::-1]), knots, 3)
    return scipy.sparse.csr_array(weights, shape=(len(u), shape[0] * shape[1]))


@functools.lru_cache(maxsize=3)
def _fitted_camera(view: ExportedView, colour: str) -> tuple[SplinedLens, FloatArray]:
    """Fit the camera with the fewest control points that reach the target error; also return errors (n,) in pixels."""
    u, pixel = _samples(view, colour, np.linspace(0.0, 1.0, _FITTED))
    step = 1.0 / _HELD_OUT
    judged_u, judged_pixel = _samples(view, colour, np.linspace(0.5 * step, 1.0 - 0.5 * step, _HELD_OUT))
    if min(len(u), len(judged_u)) < _FEWEST:
        raise BadInputError(
            f"mrcal: fewer than {_FEWEST} of the sampled pixels of {view.origin.name} have a ray for {view.stem}; "
            "check the pupil position."
        )
    for columns in _COLUMNS:
        camera = _fit(u, pixel, columns, view.panel_size_px)
        errors = np.linalg.norm(_projected(camera, judged_u) - judged_pixel, axis=-1)
        if _rms(errors) <= _WANTED_PX:
            break
    if _rms(errors) > _REFUSED_PX:
        raise BadInputError(
            f"mrcal: the best camera model of {view.origin.name} errs by {_rms(errors):.2f} px rms for {view.stem}: "
            "its pixels are not a continuous function of the direction; choose another format, e.g. stmap."
        )
    return camera, errors


def _samples(view: ExportedView, colour: str, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sample stereographic coordinates and mrcal's pixels, each (n, 2), at panel positions from 0 to 1."""
    pixel = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2) * view.panel_size_px
    tangents = view.tangents(np.moveaxis(view.rays_at(colour, pixel), -1, 0))
    u = 2 * tangents * [1, -1] / (1 + np.sqrt(1 + np.sum(tangents**2, axis=-1)))[:, None]
    is_solved = has_ray(u)
    return u[is_solved], pixel[is_solved] - _CENTRE_SHIFT


def _fit(u: FloatArray, pixel: FloatArray, columns: int, size_px: tuple[int, int]) -> SplinedLens:
    """Fit a line along each axis, then the control points to the residual, by linear least squares."""
    half_x, half_y = np.abs(u).max(axis=0)
    field_x_deg = min(int(np.ceil(np.degrees(4 * np.arctan(half_x / 2)))), _WIDEST_DEG)
    shape = columns, int(np.ceil(2 * half_y * _intervals_per_unit(field_x_deg, columns))) + 3
    lines = [np.polyfit(u[:, axis], pixel[:, axis], 1) for axis in (0, 1)]
    focal_px, centre_px = np.array(lines).T
    weights = _spline_weights(u, field_x_deg, shape)
    rough = _third_differences(shape)
    normal = weights.T @ weights + _SMOOTHING**2 * len(u) / rough.shape[0] * (rough.T @ rough)
    left = (pixel - centre_px) / focal_px - u
    control = np.linalg.solve(normal.toarray(), weights.T @ left)
    return SplinedLens(size_px, focal_px, centre_px, control.reshape(shape[1], shape[0], 2), 3, field_x_deg)


def _projected(camera: SplinedLens, u: FloatArray) -> FloatArray:
    """Return the pixels (n, 2) of stereographic coordinates (n, 2); like mrcal, even where the spline folds."""
    rows, columns, _ = camera.control.shape
    shift = _spline_weights(u, camera.fov_x_deg, (columns, rows)) @ camera.control.reshape(-1, 2)
    return np.asarray((u + shift) * camera.focal_px + camera.centre_px)


def _third_differences(shape: tuple[int, int]) -> "scipy.sparse.csr_array":
    """Return the third differences of neighbouring control points along both axes, (m, control points)."""
    along = [
        scipy.sparse.diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(max(size - 3, 0), size))
        for size in shape
    ]
    across, down = (scipy.sparse.eye_array(size) for size in shape[::-1])
    both = scipy.sparse.kron(across, along[0]), scipy.sparse.kron(along[1], down)
    return scipy.sparse.csr_array(scipy.sparse.vstack(both))


def _cameramodel(view: ExportedView, fitted: tuple[SplinedLens, FloatArray], texts: dict[str, str]) -> str:
    camera, errors = fitted
    comments = [
        "Panel pixels as one pupil sees them, as a camera model. It holds for this pupil and for points at this depth "
        "only (depth_m); loses says what other ones cost.",
        f"Error of the splines at pixels that were not fitted: {_rms(errors):.5f} px rms, {errors.max():.5f} px at "
        "most.",
        *(f"{name}: {text}" for name, text in texts.items()),
    ]
    rows, columns, _ = camera.control.shape
    grid = f"order=3_Nx={columns}_Ny={rows}_fov_x_deg={camera.fov_x_deg:g}"
    intrinsics = np.concatenate([camera.focal_px, camera.centre_px, camera.control.ravel()])
    lines = [
        *("# " + " ".join(comment.split()) for comment in comments),
        "{",
        f"'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_{grid}',",
        f"'intrinsics': {_numbers(intrinsics)},",
        f"'extrinsics': {_numbers(_camera_from_device(view))},",
        f"'imagersize': {list(view.panel_size_px)},",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _camera_from_device(view: ExportedView) -> FloatArray:
    """Return the extrinsics (6,): Rodrigues vector and translation from the device frame to OpenCV's camera axes."""
    turned = view.source.device_from_camera @ transforms.OPENXR_FROM_OPENCV
    pose = transforms.inverse(transforms.rigid(turned, view.source.position_in_device))
    return np.concatenate([scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _numbers(values: FloatArray) -> str:
    return "[" + ", ".join(f"{value:.13g}" for value in values.tolist()) + "]"
