"""Headsets as a projector with a flat virtual image: SPAAM, Display Relative Calibration, and INDICA.

- SPAAM: M. Tuceryan and N. Navab, "Single point active alignment method (SPAAM) for optical see-through HMD
  calibration for AR", ISAR 2000; M. Tuceryan, Y. Genc and N. Navab, Presence 11(3), 2002.
- Display Relative Calibration (DRC): C. B. Owen, J. Zhou, A. Tang and F. Xiao, "Display-relative calibration for
  optical see-through head-mounted displays", ISMAR 2004.
- INDICA: Y. Itoh and G. Klinker, "Interaction-free calibration for optical see-through head-mounted displays based on
  3D eye localization", 3DUI 2014. The formulas follow the authors' published code.
"""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import least_squares
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from benchmarks.rivals.pinhole_models import FixedEyeSeeThrough, PinholeDisplay, homogeneous
from wlr_render.calibration.readings import fitted_box
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.mappings import EYE_BOX_MARGIN
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box

_FEWEST_ALIGNMENTS = 6
_FLAT = 1e-3  # largest thickness of points on a line or in a plane, over their widest extent
_UNDETERMINED = 1e-7  # smallest ratio of a fit's singular values, of scaled derivatives
_SPAAM_NUMBERS = 11


def spaam(captures: Captures) -> tuple[PinholeDisplay, FixedEyeSeeThrough]:
    """Fit the Single Point Active Alignment Method (Tuceryan and Navab 2000): a 3 x 4 projection for one eye position.

    The world-to-pixel matrix comes from a direct linear transform with Hartley's normalisation, refined by least
    squares of the reprojection. Adapted: no user aligns; the see-through captures supply the points in the directions
    of the decoded pixels.

    Args:
        captures: display and see-through captures from the same positions.

    Returns:
        Display and see-through, which are meaningful only together: see-through backward, then display backward is the
        projection of a point to its pixel, for all viewpoints.

    Raises:
        BadInputError: a part is missing, no target was seen from the display's camera position nearest to the eye box's
            centre, or the alignments do not determine a projection.
    """
    display, see_through = captures.both
    centre = display.eye_box.centre
    nearest = int(display.capture[np.argmin(np.linalg.norm(display.viewpoint - centre, axis=1))])
    return _by_position(display, see_through, [nearest])


def spaam_redone(captures: Captures) -> tuple[PinholeDisplay, FixedEyeSeeThrough]:
    """Fit SPAAM at each camera position; a viewpoint uses the nearest position; see `spaam`.

    It is the best case of a user who aligns again after each motion of the headset.

    Raises:
        BadInputError: see `spaam`; also for any single camera position.
    """
    display, see_through = captures.both
    return _by_position(display, see_through, np.unique(display.capture).tolist())


def direct_plane(captures: DisplayCaptures) -> PinholeDisplay:
    """Fit Display Relative Calibration (Owen et al. 2004): a flat virtual image in space, 11 numbers.

    Adapted: the image is stored in homogeneous coordinates, so that it may lie at or beyond infinity; its axes need not
    be perpendicular; the fit minimises angles. The captures give the eye's position. The method ignores refraction in
    the combiner: combine it with `models.see_through_model.undeviated`, or with a static see-through model.

    Raises:
        BadInputError: the captures do not determine the image.
    """
    box, scaled, affine = _start(captures)

    def image(parameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.append(parameter[:8], -1.0).reshape(3, 3), parameter[8:]

    start = np.concatenate([affine.ravel(), np.zeros(5)])
    return _image_display(captures, box, *_fit_image(captures, scaled, image, start), numbers=11)


def indica_full(captures: DisplayCaptures) -> PinholeDisplay:
    """Fit INDICA, full setup (Itoh and Klinker 2014): a rectangular screen of known pose and pixel pitch, 8 numbers.

    P = Q diag(ax, ay, 1) [[bz, 0, -bx], [0, bz, -by], [0, 0, 1]] [R | t], with b the screen's position relative to the
    eye. Adapted: pose and pitch are fitted to captures, by angles. It ignores refraction in the combiner, see
    `direct_plane`.

    Raises:
        BadInputError: the captures do not determine the screen.
    """
    box, scaled, affine = _start(captures)
    across = np.append(affine[:, 0], 0.0)
    down = np.append(affine[:, 1], 0.0)
    down -= across * (across @ down) / (across @ across)
    sizes = np.linalg.norm([across, down], axis=1)
    axes = np.column_stack([across / sizes[0], down / sizes[1], np.cross(across, down) / np.prod(sizes)])

    def image(parameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        turned = Rotation.from_rotvec(parameter[:3]).as_matrix() @ axes
        matrix = np.column_stack([turned[:, :2] * parameter[3:5], np.append(parameter[5:7], -1.0)])
        return matrix, np.array([0.0, 0.0, parameter[7]])

    start = np.concatenate([np.zeros(3), sizes, affine[:, 2], [0.0]])
    return _image_display(captures, box, *_fit_image(captures, scaled, image, start), numbers=8)


def indica_recycle(captures: Captures) -> PinholeDisplay:
    """Fit INDICA, recycle setup (Itoh and Klinker 2014): SPAAM at one eye position, shifted by the screen's distance.

    P = K_E0 K2 [R | t], K2 = [[z + dz, 0, -dx], [0, z + dz, -dy], [0, 0, z]] / z, with d the motion of the eye since
    SPAAM and z its distance from the screen. So the screen is a plane across SPAAM's optical axis, and K_E0 need not be
    separated from R. Adapted: z, there a manufacturer's figure, is fitted to all display captures. It ignores
    refraction in the combiner, see `direct_plane`.

    Raises:
        BadInputError: all captures were taken at one position; see also `spaam`.
    """
    display, _ = captures.both
    _require_positions(display)
    first, see_through = spaam(captures)
    eye, matrix = see_through.eye[0], first.matrix[0]
    axis = np.array([0.0, 0.0, 1.0])  # all pixels of SPAAM's matrix have the same depth along its optical axis
    found = _fit_image(
        display, homogeneous(display.pixel), lambda parameter: (matrix, axis * parameter[0]), np.zeros(1), origin=eye
    )
    return _image_display(display, _pixel_box(display), *found, eye, numbers=_SPAAM_NUMBERS + 1)


def _by_position(
    display: DisplayCaptures, see_through: SeeThroughCaptures, names: list[int]
) -> tuple[PinholeDisplay, FixedEyeSeeThrough]:
    """Fit SPAAM at camera positions of the display captures."""
    positions, matrices, eyes = [], [], []
    for name in names:
        here = select(display, display.capture == name)
        projection = fit_projection(*_alignments(here, see_through), f"camera position {name} of {display.device}")
        inverse = np.linalg.inv(projection[:, :3])
        positions.append(here.viewpoint[0])
        matrices.append(inverse)
        eyes.append(-inverse @ projection[:, 3])
    box = _pixel_box(select(display, np.isin(display.capture, names)))
    place, none, numbers = np.array(positions), np.zeros((len(names), 3)), _SPAAM_NUMBERS * len(names)
    return (
        PinholeDisplay(display.panel, display.eye_box, box, place, np.array(matrices), none, numbers),
        FixedEyeSeeThrough(see_through.eye_box, place, np.array(eyes)),
    )


def _alignments(display: DisplayCaptures, see_through: SeeThroughCaptures) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and the real points (n, 3) behind them, target by target, from one camera position."""
    near = np.linalg.norm(see_through.viewpoint - display.viewpoint[0], axis=1) <= EYE_BOX_MARGIN
    pixels, points = [np.empty((0, 2))], [np.empty((0, 3))]
    for pose in np.unique(see_through.target_pose[near]):
        rows = np.flatnonzero(near & (see_through.target_pose == pose))
        tangents, kept = np.unique(see_through.tangents[rows], axis=0, return_index=True)
        if not _spans(tangents, 2):
            continue
        inside = Delaunay(tangents).find_simplex(display.tangents) >= 0
        if inside.any():
            behind = RBFInterpolator(tangents, see_through.point[rows[kept]], kernel="thin_plate_spline")
            pixels.append(display.pixel[inside])
            points.append(behind(display.tangents[inside]))
    return np.concatenate(pixels), np.concatenate(points)


def fit_projection(pixel: FloatArray, point: FloatArray, where: str) -> FloatArray:
    """Fit SPAAM's projection to alignments: a direct linear transform, refined by least squares of the reprojection.

    Args:
        pixel: (n, 2) px.
        point: (n, 3) real points, in any frame and unit of length.
        where: name of the alignments for error messages.

    Returns:
        (3, 4) matrix from homogeneous points of that frame to homogeneous pixels; the third coordinate of its products
        is positive in front of the eye.

    Raises:
        BadInputError: there are fewer than six alignments, or their points lie in one plane.
    """
    if len(pixel) < _FEWEST_ALIGNMENTS or not _spans(pixel, 2) or not _spans(point, 3):
        raise BadInputError(
            f"{where} gives {len(pixel)} alignments of pixels and real points; SPAAM needs {_FEWEST_ALIGNMENTS} or "
            "more that do not lie in one plane: take see-through captures of two target depths from the same position."
        )
    to_pixel, to_point = _normalisation(pixel), _normalisation(point)
    seen, world = homogeneous(pixel) @ to_pixel.T, homogeneous(point) @ to_point.T
    none = np.zeros_like(world)
    rows = np.concatenate(
        [np.hstack([world, none, -seen[:, :1] * world]), np.hstack([none, world, -seen[:, 1:2] * world])]
    )
    start = np.linalg.svd(rows, full_matrices=False)[2][-1]
    free = np.arange(12) != np.argmax(np.abs(start))

    def matrix(parameter: FloatArray) -> FloatArray:
        whole = start.copy()
        whole[free] = parameter
        return np.asarray(whole.reshape(3, 4))

    def miss(parameter: FloatArray) -> FloatArray:
        image = world @ matrix(parameter).T
        return np.asarray((image[:, :2] / image[:, 2:] - seen[:, :2]).ravel())

    found = matrix(least_squares(miss, start[free], x_scale="jac").x)
    found = found * np.sign(np.median(world @ found[2]))
    return np.asarray(np.linalg.solve(to_pixel, found @ to_point))


def _normalisation(points: FloatArray) -> FloatArray:
    """Return Hartley's normalisation: a homogeneous matrix that centres points (n, d) with mean square scaled to d."""
    size, mean = points.shape[1], points.mean(axis=0)
    scale = np.sqrt(size / np.mean(np.sum((points - mean) ** 2, axis=1)))
    matrix = np.diag(np.append(np.full(size, scale), 1.0))
    matrix[:size, size] = -scale * mean
    return matrix


def _start(captures: DisplayCaptures) -> tuple[Box, FloatArray, FloatArray]:
    """Return the pixels' box, scaled homogeneous pixels (n, 3), and the affine map (2, 3) from them to the tangents.

    Raises:
        BadInputError: there are fewer than two positions, or the pixels lie on one line.
    """
    _require_positions(captures)
    if not _spans(captures.pixel, 2):
        raise BadInputError(
            f"the decoded pixels of {captures.device} lie on one line; decode pixels all over the panel."
        )
    box = _pixel_box(captures)
    scaled = homogeneous(box.scaled(captures.pixel))
    return box, scaled, np.asarray(np.linalg.lstsq(scaled, captures.tangents, rcond=None)[0].T)


def _require_positions(captures: DisplayCaptures) -> None:
    if np.ptp(captures.viewpoint, axis=0).max() <= EYE_BOX_MARGIN:
        raise BadInputError(
            f"all display captures of {captures.device} were taken at one position; a virtual image in space needs two "
            "or more camera positions."
        )


def _fit_image(
    captures: DisplayCaptures,
    pixel: FloatArray,
    image: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    origin: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fit a matrix (3, 3) and an inverse depth (3,) with the least angles to captures.

    Args:
        captures: n readings of the panel.
        pixel: (n, 3) homogeneous pixels of the captures, scaled to the box or not.
        image: function of parameters that returns matrix and inverse depth, see `PinholeDisplay`.
        start: start parameters.
        origin: (3,) metres, position of the matrix; None for the eye box's centre.
    """
    shift = captures.viewpoint - (captures.eye_box.centre if origin is None else origin)
    sigma = captures.sigma_arcmin if np.any(captures.sigma_arcmin > 0) else np.ones(len(captures))
    weight = 1.0 / (ARCMIN * sigma[:, None])

    def miss(parameter: FloatArray) -> FloatArray:
        matrix, inverse_depth = image(parameter)
        direction = pixel @ matrix.T - (pixel @ inverse_depth)[:, None] * shift
        return np.asarray((weight * (normalised(direction) - captures.view_dir)).ravel())

    found = least_squares(miss, start, x_scale="jac")
    size = np.linalg.norm(found.jac, axis=0)
    values = np.linalg.svd(found.jac / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if size.min() == 0.0 or values[-1] <= _UNDETERMINED * values[0]:
        raise BadInputError(
            f"the display captures of {captures.device} do not determine a flat virtual image; decode pixels all over "
            "the panel, from camera positions farther apart."
        )
    return image(found.x)


def _image_display(
    captures: DisplayCaptures,
    box: Box,
    matrix: FloatArray,
    inverse_depth: FloatArray,
    origin: FloatArray | None = None,
    *,
    numbers: int,
) -> PinholeDisplay:
    """Return a flat image's display. Without an origin, the matrix is for the eye box's centre, in scaled pixels."""
    if origin is None:
        origin = captures.eye_box.centre
        per_pixel = np.diag(np.append(box.per_unit, 1.0))
        per_pixel[:2, 2] = box.scaled(np.zeros(2))
        matrix, inverse_depth = matrix @ per_pixel, inverse_depth @ per_pixel
    return PinholeDisplay(
        captures.panel, captures.eye_box, box, origin[None], matrix[None], inverse_depth[None], numbers
    )


def _pixel_box(captures: DisplayCaptures) -> Box:
    return fitted_box(captures.pixel, np.zeros(2, bool))


def _spans(points: FloatArray, dimensions: int) -> bool:
    """Return whether points (n, any) extend in at least a number of dimensions."""
    if len(points) <= dimensions:
        return False
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[dimensions - 1] > _FLAT * extent[0])
