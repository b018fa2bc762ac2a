"""Starting values of a bench: lenses and board poses by OpenCV, then targets, camera and stage by a chain of views."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import scipy

from wlr_render import usual
from wlr_render.calibration.bench.bench_blocks import (
    FEATURES,
    FLAT,
    HELD_POSE,
    POSE,
    TURNS,
    Block,
    Key,
    axis_block,
    lens_block,
    numbers_block,
    pose_block,
    shape_block,
    stage_error_blocks,
    stated_twist,
    with_residual,
)
from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.calibration.bench.board_views import (
    APART,
    EYEBALL,
    TRACKING,
    BenchObservations,
    BoardView,
)
from wlr_render.calibration.bench.state import DRIFT_DEGREE, BenchState, screw_key, stage_motion
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens import Lens
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray

_SOME = 80  # number of features of a view for starts, which need not be exact; OpenCV's time grows with it
_SOME_VIEWS = 8  # number of views for the comparison of rough lenses
_CORNER_DEG = np.geomspace(15.0, 150.0, 12)  # tried angles from the axis to the picture's corner
_LEAST_COSINE = 0.17  # least cosine from the axis of features for a starting pose; others have too much weight
_STEPS, _CLOSE = 30, 1e-9  # most steps of a pose, and last step, radians and metres, far below any noise
_UNCLEAR = 5.0  # ratio of residuals of a plane's two poses below which both are refined, because noise may swap them
_MOVED = 1e-3  # least travel of a moving axis in photographs, relative to half its travel; less is encoder error
"""An axis whose readings vary by less than this share of its travel has not moved."""


def start_lens(views: Sequence[BoardView], size_px: tuple[int, int], kind: str) -> LensCamera:
    """Return a rough lens from views of boards: by OpenCV, and for the kind "fisheye" also by trial focal lengths.

    Raises:
        BadInputError: the views do not determine the lens.
    """
    some = [view.only(np.arange(len(view)) % max(1, len(view) // _SOME) == 0) for view in views]
    if kind == "fisheye":
        return min(_fisheye_lenses(some, size_px), key=lambda lens: _rough_misfit_px(lens, some))
    return _brown_lens(some, size_px).as_kind(kind)


def _brown_lens(views: Sequence[BoardView], size_px: tuple[int, int]) -> LensCamera:
    """Calibrate a rough Brown lens with OpenCV (Z. Zhang, PAMI 22 (2000) 1330)."""
    flat = [(view.point * [1.0, 1.0, 0.0]).astype(np.float32) for view in views]
    seen = [(view.pixel + OPENCV_PIXEL_SHIFT).astype(np.float32) for view in views]
    held = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # several threads would sum the views in an order that changes from run to run
    try:
        _, matrix, found, _, _ = cv2.calibrateCamera(flat, seen, size_px, None, None, flags=held)
    except cv2.error as error:
        raise undetermined(views) from error
    finally:
        cv2.setNumThreads(threads)
    centre = matrix[:2, 2] - OPENCV_PIXEL_SHIFT
    return LensCamera(size_px, np.diag(matrix)[:2].copy(), centre, found.ravel()[:5].copy())


def _fisheye_lenses(views: Sequence[BoardView], size_px: tuple[int, int]) -> list[LensCamera]:
    """Return equidistant lenses of many fields of view, and OpenCV's lens as a polynomial of the angle."""
    half = 0.5 * np.array(size_px, dtype=float)
    radius = float(np.linalg.norm(half))
    tried = [
        LensCamera(size_px, np.full(2, radius / np.radians(corner)), half, np.zeros(4), "fisheye")
        for corner in _CORNER_DEG
    ]
    try:
        brown = _brown_lens(views, size_px)
    except BadInputError:
        return tried
    corner = float(np.linalg.norm(half / brown.focal_px))
    tangent = np.linspace(0.02, 1.0, 40) * min(corner, 2.0)
    k1, k2 = brown.distortion[:2]
    distorted, angle = tangent * (1.0 + k1 * tangent**2 + k2 * tangent**4), np.arctan(tangent)
    powers = angle[:, None] ** np.array([3, 5])
    terms = np.linalg.lstsq(powers, distorted - angle, rcond=None)[0]
    return [*tried, LensCamera(size_px, brown.focal_px, brown.centre_px, np.array([*terms, 0.0, 0.0]), "fisheye")]


def _rough_misfit_px(lens: Lens, views: Sequence[BoardView]) -> float:
    """Return the mean, over some views, of the residuals' robust scale at the best poses."""
    scales = []
    for view in views[:: -(-len(views) // _SOME_VIEWS)]:
        try:
            scales.append(board_pose(lens, view)[1] * float(np.median(view.sigma_px)))
        except BadInputError:
            scales.append(float(np.linalg.norm(lens.size_px)))
    return float(np.mean(np.minimum(scales, np.linalg.norm(lens.size_px))))


def board_pose(lens: Lens, view: BoardView) -> tuple[FloatArray, float]:
    """Return camera_from_board (4, 4) of a flat board for a known lens, and the residuals' robust scale in sigmas."""
    direction = lens.dir_of_pixel(view.pixel)
    seen = np.isfinite(direction).all(axis=1)
    # A camera rotated towards the board has all of it less than 90 degrees off axis, for any direction of the lens.
    middle = direction[seen].sum(axis=0) if seen.any() else np.array([0.0, 0.0, 1.0])
    ahead = scipy.spatial.transform.Rotation.align_vectors([[0.0, 0.0, 1.0]], middle[None])[0].as_matrix()
    direction = direction @ ahead.T
    good = seen & (direction[:, 2] > _LEAST_COSINE)
    if np.count_nonzero(good) < 4:
        raise BadInputError(
            f"{view.name}: shows features where the camera's lens model has no inverse; leave it out, or "
            "photograph the board nearer the middle of the picture."
        )
    tangents = direction[good, :2] / direction[good, 2:]
    flat = view.point[good] * [1.0, 1.0, 0.0]
    # T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014) 252, has two solutions.
    _, rotations, translations, _ = cv2.solvePnPGeneric(flat, tangents, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    back = transforms.rigid(ahead.T, np.zeros(3))
    few = view.only(np.arange(len(view)) % max(1, len(view) // _SOME) == 0)
    poses = [
        back @ transforms.rigid(cv2.Rodrigues(rotation)[0], translation[:, 0])
        for rotation, translation in zip(rotations, translations, strict=True)
    ]
    misses = [_refined(lens, pose, few, steps=0)[1] for pose in poses]
    near = [pose for pose, miss in zip(poses, misses, strict=True) if miss <= _UNCLEAR * min(misses)]
    if len(near) > 1:
        near = [min((_refined(lens, pose, few) for pose in near), key=lambda each: each[1])[0]]
    return _refined(lens, near[0] if near else poses[0], view)


def _refined(lens: Lens, pose: FloatArray, view: BoardView, steps: int = _STEPS) -> tuple[FloatArray, float]:
    """Return the pose after some steps, and the scale of the residuals before the last step."""
    scale = np.inf
    for number in range(steps + 1):
        point = transforms.apply(pose, view.point)
        seen = lens.project(point)
        residual = (view.pixel - seen.pixel) / view.sigma_px[:, None]
        good = np.isfinite(residual).all(axis=1)
        if np.count_nonzero(good) < 4:
            return pose, np.inf
        scale = 1.4826 * float(np.median(np.abs(residual[good])))
        if number == steps:
            break
        by_motion = np.concatenate([seen.by_point @ -transforms.cross_matrix(point), seen.by_point], axis=-1)[good]
        size = np.linalg.norm(residual[good], axis=1) / max(scale, 1e-9)
        weight = np.sqrt(np.minimum(1.0, 4.0 / np.maximum(size, 1e-9))) / view.sigma_px[good]
        design = (by_motion * weight[:, None, None]).reshape(-1, 6)
        right = (residual[good] * (weight * view.sigma_px[good])[:, None]).ravel()
        step = np.linalg.lstsq(design, right, rcond=None)[0]
        pose = small_motion(step) @ pose
        if np.abs(step).max() < _CLOSE:
            break
    return pose, scale


def start_state(observations: BenchObservations, lens: Mapping[str, Lens], rough: bool = False) -> BenchState:
    """Return starting values of all unknowns, computed with the given lenses.

    Args:
        observations: views, and prior knowledge of the bench.
        lens: lenses by camera.
        rough: True for boards without smooth fields and views without stretches, for the choice of lenses.

    Raises:
        BadInputError: the views do not determine the bench; the message names the missing data.
    """
    seen = {view.name: board_pose(lens[view.camera], view)[0] for view in observations.views}
    held = [view for view in observations.views if view.target is None]
    bound = [view for view in observations.views if view.target is not None]
    tracking = None if observations.device_from_tracking is None else observations.device_from_tracking.pose
    twists = _start_twists(observations, [view for view in bound if view.camera == EYEBALL], seen)
    chain = _Chain(observations, tracking, twists)
    chain.join(bound, seen)
    if observations.axes and not chain.base:
        raise BadInputError(
            "[[bare]]: the board is found in none of the photographs of the eyeball camera; compare [board] with the "
            "print, and photograph it whole, sharp and bright."
        )
    for number, axis in enumerate(observations.axes):
        if not twists[number].any() and chain.base:  # no view of a target shows its motion
            twists[number] = stated_twist(axis, chain.base[min(chain.base)])
    if not rough:
        lens = {name: with_residual(each, observations.cameras[name]) for name, each in lens.items()}
    names = dict.fromkeys(view.board for view in observations.views)
    boards = {name: BoardShape.of([v for v in observations.views if v.board == name], rough) for name in names}
    poses = {view.name: seen[view.name] for view in held}
    return BenchState(observations, boards, _blocks(observations, lens, boards, chain, poses, rough))


def _blocks(
    seen: BenchObservations,
    lens: Mapping[str, Lens],
    boards: Mapping[str, BoardShape],
    chain: "_Chain",
    held: Mapping[str, FloatArray],
    rough: bool,
) -> dict[Key, Block]:
    """Return all blocks of unknowns at their starting values; `held` has the poses of boards held freely."""
    flat, first = np.full(6, FLAT), min(chain.base, default=0)
    blocks: dict[Key, Block] = {
        ("lens", name): lens_block(name, each, seen.cameras[name]) for name, each in lens.items()
    }
    for name, shape in boards.items():
        blocks["shape", name] = shape_block(shape, seen.tolerances[name])
    views = [view for view in seen.views if view.camera == EYEBALL and view.target is not None]
    for number in dict.fromkeys(int(view.target or 0) for view in views):
        blocks["focus", number] = numbers_block(np.array([usual.CAMERA_FOCUS_BREATHING.value]), source=ErrorSource.LENS)
    for number, pose in chain.targets.items():
        blocks["target", number] = pose_block(pose, seen.targets.get(number), ErrorSource.TARGETS)
    if (tracking := seen.device_from_tracking) is not None:
        blocks["extrinsics", TRACKING] = pose_block(tracking.pose, tracking, ErrorSource.TRACKING_CAMERA)
    for number, pose in chain.base.items():
        known = seen.device_from_camera if number == first else None
        blocks["base", number] = pose_block(pose, known, ErrorSource.STAGE)
    for number, (axis, twist) in enumerate(zip(seen.axes, chain.twists, strict=True)):
        blocks["axis", number] = axis_block(axis, twist, chain.base[first])
    blocks |= stage_error_blocks(seen.axes)
    if seen.duration is not None and all(place.time_s is not None for place in seen.places.values()):
        for degree in range(1, DRIFT_DEGREE + 1):
            blocks["drift", degree] = numbers_block(np.full(2, 1.0 / degree), {"drift": 1.0}, ErrorSource.BENCH_DRIFT)
    visits = {place: reading for place in chain.visited if (reading := seen.places[place].reading) is not None}
    screws = {screw_key(axis, each) for each in visits.values() for axis in range(len(each))}
    blocks |= {key: numbers_block(np.ones(1), {"screw": 1.0}, ErrorSource.STAGE) for key in sorted(screws)}
    blocks |= {("offset", place): numbers_block(np.ones(6), {"turn": TURNS, "shift": 1.0 - TURNS}) for place in visits}
    if not rough:
        blocks |= {("stretch", name): numbers_block(np.ones(4), {"stretch": 1.0}) for name in held}
    blocks |= {("free", place): Block(pose, flat, chart=POSE) for place, pose in chain.free.items()}
    blocks |= {("board pose", name): Block(pose, flat, chart=HELD_POSE) for name, pose in held.items()}
    for name, shape in boards.items():
        size = np.full((len(shape.feature), 3), seen.tolerances[name].print_error_m)
        blocks[FEATURES, name] = numbers_block(size)
    return blocks


def _start_twists(
    observations: BenchObservations, views: Sequence[BoardView], seen: Mapping[str, FloatArray]
) -> FloatArray:
    """Return twists (m, 6) of the axes, from camera motions between views of one target in the first mounting.

    The twist is zero for an axis along which the views do not vary.
    """
    axes = observations.axes
    if not axes:
        return np.zeros((0, 6))
    middle, half = observations.travel
    design, motion = [], []
    groups: dict[tuple[int, int], list[BoardView]] = {}
    first_mounting = min((place.orientation for place in observations.places.values()), default=0)
    for view in views:
        place = observations.places[str(view.place)]
        if place.reading is not None and place.orientation % APART == first_mounting:
            groups.setdefault((int(view.target or 0), place.orientation), []).append(view)
    for group in groups.values():
        reading = np.array([observations.places[str(view.place)].reading for view in group])
        first = int(np.argmin(np.sum(((reading - middle) / half) ** 2, axis=1)))
        reference = seen[group[first].name]
        for view, at in zip(group, reading, strict=True):
            design.append(at - reading[first])
            motion.append(motion_between(np.eye(4), reference @ transforms.inverse(seen[view.name])))
    known = [number for number, axis in enumerate(axes) if axis.direction is not None]
    matrix = np.array(design).reshape(-1, len(axes))
    scale = np.linalg.norm(matrix, axis=0)
    still = scale <= _MOVED * half
    for number in map(int, np.flatnonzero(still)):
        if number not in known and observations.travel[1][number] != 1.0:
            raise BadInputError(
                f"the stage is read along axis {number + 1}, along which no photograph of the target without the "
                "headset varies; photograph it without the headset at other readings of that axis too, or state the "
                "axis' 'direction' under [stage]."
            )
    twists = np.zeros((len(axes), 6))
    used = np.flatnonzero(~still)
    if len(used):
        twists[used] = np.linalg.lstsq(matrix[:, used], np.array(motion), rcond=None)[0]
    for number, axis in enumerate(axes):
        if axis.kind == "linear":
            twists[number, :3] = 0.0
        if still[number] and axis.is_in_camera:
            twists[number] = stated_twist(axis, np.eye(4))
    return twists


class _Chain:
    """Poses found so far; each view links a known pose to an unknown one."""

    def __init__(self, observations: BenchObservations, tracking: FloatArray | None, twists: FloatArray) -> None:
        self._observations, self._tracking, self.twists = observations, tracking, twists
        self.targets = {number: known.pose for number, known in observations.targets.items()}
        self.base: dict[int, FloatArray] = {}
        self._first = min((place.orientation for place in observations.places.values()), default=0)
        if observations.device_from_camera is not None:
            self.base[self._first] = observations.device_from_camera.pose
        self.free: dict[str, FloatArray] = {}
        self.visited: list[str] = []

    def join(self, views: Sequence[BoardView], seen: Mapping[str, FloatArray]) -> None:
        """Find the poses of all targets, mountings and free places.

        Raises:
            BadInputError: a view has no link to a known pose.
        """
        waiting = list(views)
        middle, half = self._observations.travel
        # Places near the middle come first, because their stage error is smallest.
        waiting.sort(key=lambda view: self._distance(view, middle, half))
        while waiting:
            left = [view for view in waiting if not self._join(view, seen[view.name])]
            if len(left) == len(waiting):
                raise BadInputError(
                    f"nothing places {left[0].name} in the device frame: its target pose {left[0].target} was seen "
                    "neither by the tracking camera nor from a camera place that is known; photograph that pose with "
                    "the tracking camera, or give it as [[target]]."
                )
            waiting = left
        self.visited = list(dict.fromkeys(str(view.place) for view in views if view.camera == EYEBALL))

    def _distance(self, view: BoardView, middle: FloatArray, half: FloatArray) -> float:
        if view.camera == TRACKING:
            return -1.0
        reading = self._observations.places[str(view.place)].reading
        return 0.0 if reading is None else float(np.sum(((reading - middle) / half) ** 2))

    def _join(self, view: BoardView, camera_from_board: FloatArray) -> bool:
        target = int(view.target or 0)
        if view.camera == TRACKING:
            if self._tracking is None:
                return False
            self.targets.setdefault(target, self._tracking @ camera_from_board)
            return True
        place = self._observations.places[str(view.place)]
        stage = (
            None if place.reading is None else stage_motion(self.twists, place.reading - self._observations.travel[0])
        )
        known = self.free.get(str(view.place)) if stage is None else self.base.get(place.orientation)
        if stage is not None and place.orientation != self._first:
            if self._first not in self.base:
                return False
            first = self.base[self._first]
            stage = first @ stage @ transforms.inverse(first)  # motion of the carriage, device frame
        if known is not None:
            device_from_camera = known
            if stage is not None:
                device_from_camera = known @ stage if place.orientation == self._first else stage @ known
            self.targets.setdefault(target, device_from_camera @ camera_from_board)
            return True
        if target not in self.targets:
            return False
        device_from_camera = self.targets[target] @ transforms.inverse(camera_from_board)
        if stage is None:
            self.free[str(view.place)] = device_from_camera
        elif place.orientation == self._first:
            self.base[self._first] = device_from_camera @ transforms.inverse(stage)
        else:
            self.base[place.orientation] = transforms.inverse(stage) @ device_from_camera
        return True


def undetermined(views: Sequence[BoardView]) -> BadInputError:
    """Return the error for views that do not determine a camera."""
    return BadInputError(
        f"the {len(views)} photographs {views[0].name} to {views[-1].name} do not determine the camera's focal length "
        "and centre, because they show the board parallel to the image or always at the same tilt; add photographs of "
        "it tilted by 20 to 40 degrees to the left, right, top and bottom."
    )
