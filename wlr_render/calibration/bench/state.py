"""Values of all unknowns of a bench, the predicted image of each view, and its derivatives.

The pose of the eyeball camera at a place is device_from_camera = base @ stage(reading) @ motion(offset) @ mount. `base`
is the pose at the middle of the readings in the first mounting, and `mount` is the pose of another mounting relative to
the first one. `stage` moves the camera along the stage's axes, as a product of exponentials in the order of the axes
(F. C. Park, "Computational aspects of the product-of-exponentials formula", IEEE Trans. Automatic Control 39 (1994)
643). `offset` is the stage's error: a smooth function of each axis' reading (pitch, yaw, roll and straightness, as
Legendre polynomials), an error of each axis at each of its readings (the screw), and a random error in every visit. If
times are known, the image of a camera that warms up shifts smoothly in time, nearly as by a turn of the camera.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from wlr_render.calibration.bench.bench_blocks import AXIS_PARTS, FEATURES, Block, Key, stated_twist
from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.calibration.bench.board_views import EYEBALL, TRACKING, BenchObservations, BoardView
from wlr_render.calibration.poses import adjoint, small_motion
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray

DRIFT_DEGREE = 4
SAME_READING = 1e-4
"""Resolution at which readings of a stage's axis share one screw error, metres."""

_TERMS = 12  # terms of the Jacobian's series, exact to rounding up to a radian


@dataclass(frozen=True, eq=False)
class StageModel:
    """Camera motion as a function of the stage readings, camera frame.

    Attributes:
        middle, half_range: (m,) middle and half range of the readings.
        twists: (m, 6) rotation and translation per unit of reading, by axis.
        smooth: (axes times degrees, 6) coefficients of the smooth error for `smooth_terms`.
    """

    middle: FloatArray
    half_range: FloatArray
    twists: FloatArray
    smooth: FloatArray

    def nominal(self, reading: FloatArray) -> FloatArray:
        """Return the motion (4, 4) to a reading (m,) without the stage's errors."""
        return stage_motion(self.twists, reading - self.middle)

    def smooth_terms(self, reading: FloatArray) -> FloatArray:
        """Return Legendre polynomials (terms,) of unit rms by axis at a reading (m,), clamped to the range."""
        at = np.clip((reading - self.middle) / self.half_range, -1.0, 1.0)
        degree = len(self.smooth) // max(len(at), 1)
        return unit_legendre(at, degree).ravel()

    def smooth_error(self, reading: FloatArray) -> FloatArray:
        """Return the smooth error (6,) at a reading (m,): rotation (rad), then translation (m)."""
        return self.smooth_terms(reading) @ self.smooth if len(self.smooth) else np.zeros(6)

    def motion(self, reading: FloatArray) -> FloatArray:
        """Return the expected motion (4, 4) to a reading (m,)."""
        return np.asarray(self.nominal(reading) @ small_motion(self.smooth_error(reading)))


@dataclass(frozen=True, eq=False)
class BenchState:
    """Values of all unknowns, by the names of the blocks.

    | block | of each | value |
    |---|---|---|
    | lens | camera | lens |
    | shape, features | board | (k,) see `BoardShape.low`; (f, 3) errors of the features' places |
    | focus | target | (1,) relative change of the eyeball camera's focal length, focused anew or warmed up |
    | target | target | device_from_target |
    | extrinsics | tracking camera | device_from_tracking |
    | base | mounting | device_from_camera at the middle of the readings |
    | axis | axis | (6,) twist: rotation and translation, camera frame, per unit of reading |
    | smooth | term | (6,) of the stage's smooth error, see `StageModel` |
    | screw | reading of an axis | (1,) error along the axis, metres |
    | offset | place | (6,) random error of a visit, camera frame |
    | drift | degree | (2,) turn about the camera's x and y with time, see `drift_terms` |
    | stretch | view of a board held freely | (4,) by `stretch_terms`, of a focus that hunts or a rolling shutter |
    | free | place without reading | device_from_camera |
    | board pose | view of a board held freely | camera_from_board |

    Axes and errors of the stage are in the camera frame of the mounting with the lowest number.

    Attributes:
        observations: views and prior knowledge to which the values are fitted.
        boards: features and fields of each board, without errors.
        blocks: blocks by key.
    """

    observations: BenchObservations
    boards: Mapping[str, BoardShape]
    blocks: Mapping[Key, Block]

    def of(self, kind: str) -> Mapping[Any, Any]:
        """Return the values of all blocks of one kind, by the second part of the keys."""
        return self._by_kind.get(kind, {})

    @cached_property
    def _by_kind(self) -> dict[str, dict[int | str, Any]]:
        found: dict[str, dict[int | str, Any]] = {}
        for (kind, which), block in self.blocks.items():
            found.setdefault(kind, {})[which] = block.value
        return found

    @property
    def lens(self) -> Mapping[str, Lens]:
        """Lenses by camera."""
        return self.of("lens")

    @cached_property
    def shape(self) -> Mapping[str, BoardShape]:
        """Shapes by board."""
        low, place = self.of("shape"), self.of(FEATURES)
        return {name: replace(each, low=low[name], place=place[name]) for name, each in self.boards.items()}

    @property
    def targets(self) -> Mapping[int, FloatArray]:
        """device_from_target by number."""
        return self.of("target")

    @property
    def base(self) -> Mapping[int, FloatArray]:
        """device_from_camera at the middle of the readings, by mounting."""
        return self.of("base")

    @property
    def device_from_tracking(self) -> FloatArray | None:
        """Pose (4, 4) of the tracking camera; None without one."""
        return self.of("extrinsics").get(TRACKING)

    @cached_property
    def twists(self) -> FloatArray:
        """Twists (axes, 6) of the stage's axes."""
        return np.array(list(self.of("axis").values())).reshape(-1, 6)

    @cached_property
    def stage(self) -> StageModel:
        """Camera motion as a function of the stage readings."""
        middle, half_range = self.observations.travel
        smooth = np.array(list(self.of("smooth").values())).reshape(-1, 6)
        return StageModel(middle, half_range, self.twists, smooth)

    @property
    def first_mounting(self) -> int:
        """Orientation with the camera frame of the stage's axes and errors; BadInputError if no view shows it."""
        if not self.base:
            raise BadInputError(
                "No photograph of the target without the headset or past its optics could be used, so nothing says "
                "where the stage carries the camera; take [[bare]] or [[beside]] photographs again."
            )
        return min(self.base)

    def mount(self, orientation: int) -> FloatArray:
        """Return the transform (4, 4) from the camera frame of a mounting to the first mounting's camera frame."""
        if orientation == self.first_mounting:
            return np.eye(4)
        return np.asarray(transforms.inverse(self.base[self.first_mounting]) @ self.base[orientation])

    def device_from_camera(self, place: str) -> FloatArray:
        """Return the eyeball camera's pose (4, 4) at a place; the expected pose if no view measured it."""
        if place in self.of("free"):
            return np.asarray(self.of("free")[place])
        each = self.observations.places[place]
        assert each.reading is not None
        stage = self.stage
        carried = self.base[self.first_mounting] @ stage.nominal(each.reading) @ small_motion(self._stage_error(place))
        return np.asarray(carried @ self.mount(each.orientation))

    def screws(self, reading: FloatArray) -> dict[Key, FloatArray]:
        """Return the motion (6, 1) by each linear axis' error at a reading (m,), camera frame of the first mounting."""
        motions: dict[Key, FloatArray] = {}
        for number, (axis, twist) in enumerate(zip(self.observations.axes, self.twists, strict=True)):
            if axis.kind == "linear" and twist.any():
                unit = twist / np.linalg.norm(twist[3:])
                motions[screw_key(number, reading)] = unit[:, None]
        return motions

    def drift_terms(self, place: str) -> FloatArray:
        """Return Legendre polynomials (degrees,) of unit rms at the time of a place; 0 for an unknown time."""
        time_s, duration = self.observations.places[place].time_s, self.observations.duration
        if duration is None or time_s is None:
            return np.zeros(DRIFT_DEGREE)
        return unit_legendre(np.array([(time_s - duration[0]) / duration[1]]), DRIFT_DEGREE).ravel()

    def _stage_error(self, place: str) -> FloatArray:
        """Return the sum (6,) of the stage's error at a place and the camera's drift."""
        each = self.observations.places[place]
        reading = each.reading
        assert reading is not None
        error = self.stage.smooth_error(reading) + self.of("offset").get(place, np.zeros(6))
        for (_, which), along in self.screws(reading).items():
            error = error + along[:, 0] * self.of("screw").get(which, 0.0)
        if turns := self.of("drift"):
            turn = self.drift_terms(place) @ np.array(list(turns.values()))
            error = error + adjoint(self.mount(each.orientation))[:, :2] @ turn
        return np.asarray(error)

    def device_from_any(self, view: BoardView) -> FloatArray:
        """Return the pose (4, 4) of the camera for a view of a target."""
        if view.camera == TRACKING:
            assert self.device_from_tracking is not None
            return self.device_from_tracking
        assert view.place is not None
        return self.device_from_camera(view.place)

    def lens_at(self, target: int) -> Lens:
        """Return the eyeball camera's lens with its focus at a target pose."""
        lens, change = self.lens[EYEBALL], float(self.of("focus").get(target, (0.0,))[0])
        if not change or not len(lens.values):
            return lens
        return lens.with_values(lens.values * np.where(np.arange(len(lens.values)) < 2, 1.0 + change, 1.0))

    def lens_of(self, view: BoardView) -> Lens:
        """Return the lens of a view."""
        return self.lens[view.camera] if view.camera != EYEBALL or view.target is None else self.lens_at(view.target)

    def camera_from_board(self, view: BoardView) -> FloatArray:
        """Return the board's pose (4, 4) in a view."""
        if view.target is None:
            return np.asarray(self.of("board pose")[view.name])
        return np.asarray(transforms.inverse(self.device_from_any(view)) @ self.targets[view.target])

    def camera_motion(self, place: str) -> dict[Key, FloatArray]:
        """Return the small motion (6, k) of device_from_camera at a place, camera frame, by block of unknowns."""
        if place in self.of("free"):
            return {("free", place): np.eye(6)}
        each = self.observations.places[place]
        assert each.reading is not None
        stage, travel = self.stage, each.reading - self.observations.travel[0]
        back = adjoint(transforms.inverse(small_motion(self._stage_error(place))))
        carried = adjoint(transforms.inverse(stage.nominal(each.reading)))
        first = self.first_mounting
        blocks: dict[Key, FloatArray] = {("base", first): back @ carried}
        after = np.eye(6)
        for axis in range(len(travel) - 1, -1, -1):
            twist = self.twists[axis] * travel[axis]
            if travel[axis]:
                blocks["axis", axis] = travel[axis] * back @ after @ _right_jacobian(twist)
            after = after @ adjoint(_exponential(-twist))
        for number, term in enumerate(stage.smooth_terms(each.reading)):
            blocks["smooth", number] = term * np.eye(6)
        own = {("drift", k): self.drift_terms(place)[k - 1] * np.eye(6)[:, :2] for k in self.of("drift")}
        own |= {key: columns for key, columns in self.visit_motion(place).items() if key in self.blocks}
        if each.orientation == first:
            return blocks | own
        mounted = adjoint(transforms.inverse(self.mount(each.orientation)))
        blocks = {key: mounted @ columns for key, columns in blocks.items()}
        blocks["base", first] = blocks["base", first] - mounted
        return blocks | {("base", each.orientation): np.eye(6)} | own

    def visit_motion(self, place: str) -> dict[Key, FloatArray]:
        """Return the small motion (6, k), camera frame, by the stage's errors in one visit and at each axis reading.

        The keys are the same as for measured errors; the result is empty without a stage.
        """
        each = self.observations.places[place]
        if each.reading is None:
            return {}
        mounted = adjoint(transforms.inverse(self.mount(each.orientation)))
        errors = {("offset", place): np.eye(6)} | self.screws(each.reading)
        return {key: mounted @ columns for key, columns in errors.items()}

    def board_motion(self, view: BoardView, camera_from_board: FloatArray) -> dict[Key, FloatArray]:
        """Return the small motion (6, k) of camera_from_board (4, 4) in a view, camera frame, by block of unknowns."""
        if view.target is None:
            return {("board pose", view.name): np.eye(6)}
        motion: dict[Key, FloatArray] = {("target", view.target): adjoint(camera_from_board)}
        if view.camera == TRACKING:
            return motion | {("extrinsics", TRACKING): -np.eye(6)}
        assert view.place is not None
        return motion | {key: -columns for key, columns in self.camera_motion(view.place).items()}

    def deviation(self, keys: Iterable[Key]) -> FloatArray:
        """Return the steps (unknowns,) of some blocks from the middles of their priors, in the order of `keys`."""
        return np.concatenate(
            [self._off_stated(int(key[1])) if key[0] == "axis" else self.blocks[key].deviation for key in keys]
        )

    def _off_stated(self, number: int) -> FloatArray:
        """Return the difference (6,) of an axis' twist from the stated twist; zero in parts that are not stated."""
        axis, off = self.observations.axes[number], np.zeros(6)
        if axis.direction is None:
            return off
        stated = stated_twist(axis, self.base[self.first_mounting])
        for part in (AXIS_PARTS[axis.kind], *([] if axis.pivot is None else [slice(3, 6)])):
            off[part] = self.twists[number, part] - stated[part]
        return off

    def moved(self, step: Mapping[Key, FloatArray]) -> "BenchState":
        """Return the state after a step of every block of unknowns."""
        return replace(self, blocks={key: block.moved(step[key]) for key, block in self.blocks.items()})

    def with_values(self, values: Mapping[Key, Any]) -> "BenchState":
        """Return the state with other values of some blocks."""
        changed = {key: replace(self.blocks[key], value=value) for key, value in values.items()}
        return replace(self, blocks={**self.blocks, **changed})


def unit_legendre(at: FloatArray, degree: int) -> FloatArray:
    """Return Legendre polynomials (n, degree) from degree 1, of unit rms from -1 to 1, at arguments (n,)."""
    values = legendre.legvander(at, degree) * np.sqrt(2.0 * np.arange(degree + 1) + 1.0)
    return np.asarray(values[:, 1:])


def screw_key(axis: int, reading: FloatArray) -> Key:
    """Return the key of an axis' screw error at a reading (m,) of the stage."""
    return "screw", f"{axis} at {round(float(reading[axis]) / SAME_READING)}"


def stretch_terms(pixel: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Return the displacements (n, 2, 4), pixels, at pixels (n, 2), by a stretch of the image about its middle.

    The stretch is a 2 x 2 matrix, row by row: 1e-3 moves the edge of the picture by 1e-3 of half its larger side.
    """
    return np.asarray(np.kron(np.eye(2), (pixel - 0.5 * np.array(size_px))[:, None]), dtype=np.float64)


def stage_motion(twists: FloatArray, travel: FloatArray) -> FloatArray:
    """Return the product of exponentials (4, 4) of `twists` (m, 6) times `travel` (m,)."""
    pose = np.eye(4)
    for twist, amount in zip(twists, travel, strict=True):
        pose = pose @ _exponential(twist * amount)
    return pose


def _exponential(twist: FloatArray) -> FloatArray:
    """Return the rigid motion (4, 4) of a twist (6,), rotation first, applied for one unit.

    Source: K. M. Lynch and F. C. Park, "Modern Robotics" (2017), equation 3.88.
    """
    turn, shift = twist[:3], twist[3:]
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return transforms.rigid(np.eye(3), shift)
    cross = transforms.cross_matrix(turn)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    along = np.eye(3) + first * cross + second * cross @ cross
    return transforms.rigid(transforms.rotations_of_vectors(turn), along @ shift)


def _right_jacobian(twist: FloatArray) -> FloatArray:
    """Return J (6, 6) with exponential(twist + d) = exponential(twist) @ small_motion(J @ d).

    Source: T. D. Barfoot, "State Estimation for Robotics" (2017), equation 7.83.
    """
    bracket = np.zeros((6, 6))
    bracket[:3, :3] = bracket[3:, 3:] = transforms.cross_matrix(twist[:3])
    bracket[3:, :3] = transforms.cross_matrix(twist[3:])
    power, total = np.eye(6), np.eye(6)
    for k in range(1, _TERMS):
        power = power @ -bracket / (k + 1)
        total = total + power
        if not power.any():
            break
    return total
