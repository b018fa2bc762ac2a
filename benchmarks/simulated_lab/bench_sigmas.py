"""Errors of a calibrated bench over their stated sigmas, by kind of unknown."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.simulated_lab.bench_truth import BenchTruth
from wlr_render.calibration.bench.board_views import EYEBALL, TRACKING, CameraPlace
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, place_key
from wlr_render.calibration.poses import adjoint, motion_between
from wlr_render.geometry import transforms
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.camera import SimulatedLens

_GRID = (9, 7)  # numbers of pixels across and down at which directions are compared
_EDGE = 0.04  # share of the picture along its edge without features
_FEATURES = 40  # number of the board's features in the comparison
_EVERY = 4  # step between the panel's camera positions in the comparison of directions
_LEAST_SIZE = 1e-6  # smallest eigenvalue over the largest; combinations known a thousand times better are ignored


@dataclass(frozen=True)
class SquaredErrors:
    """Squares of errors over their stated sigmas.

    Attributes:
        mean_square: mean square over the components, each divided by its sigma.
        joint: chi-squared by the joint covariance over the number of components.
    """

    mean_square: float
    joint: float

    @classmethod
    def of(cls, error: FloatArray, covariance: FloatArray) -> "SquaredErrors":
        """Compute the squared errors of errors (n,) with a covariance (n, n)."""
        sigma = np.sqrt(np.diag(covariance))
        scaled = error / sigma
        size, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
        some = size > _LEAST_SIZE * size[-1]
        along = vectors[:, some].T @ scaled
        return cls(float(np.mean(scaled**2)), float(np.mean(along**2 / size[some])))


def errors_over_sigma(bench: CalibratedBench, truth: BenchTruth) -> dict[str, SquaredErrors]:
    """Return the squared errors of each kind of unknown."""
    return _Compared(bench, truth).all()


@dataclass(frozen=True, eq=False)
class _Pose:
    """An estimated and a true pose, and the derivative (6, unknowns) and additional covariance of small motions."""

    found: FloatArray
    true: FloatArray
    rows: FloatArray
    own: FloatArray


class _Compared:
    def __init__(self, bench: CalibratedBench, truth: BenchTruth) -> None:
        self._bench, self._truth, self._adjustment = bench, truth, bench.adjustment
        self._unknowns = len(bench.adjustment.layout.size)

    def all(self) -> dict[str, SquaredErrors]:
        session, truth = self._bench.session, self._truth
        cameras = [
            self._camera(place_key(session, entry), true)
            for entry, true in zip(session.display, truth.display, strict=True)
        ]
        boards = [self._board(number) for number in sorted(self._bench.targets)]
        found: dict[str, SquaredErrors] = {}
        for name, poses in (("camera places", cameras), ("target poses", [pose for pose, _ in boards])):
            found |= self._poses(f"{name}, device frame", poses)
            found |= self._poses(f"{name}, tracking camera's frame", [self._from_tracking(pose) for pose in poses])
        found["board shape"] = boards[0][1]
        found["lens of the eyeball camera, directions"] = self._lens(EYEBALL, truth.bench.eyeball)
        found["lens of the tracking camera, directions"] = self._lens(TRACKING, truth.bench.tracking)
        some = [self._from_tracking(pose) for pose in cameras[::_EVERY]]
        found["directions of pixels, tracking camera's frame"] = self._directions(some)
        return found | self._poses("travel of the stage, end to end", self._travel())

    def _covariance(self, rows: FloatArray) -> FloatArray:
        return np.asarray(rows @ self._adjustment.covariance @ rows.T)

    def _poses(self, name: str, poses: list[_Pose]) -> dict[str, SquaredErrors]:
        """Return the squared errors of rotations, and of the origins' positions."""
        parts: dict[str, FloatArray] = {"rotation": np.eye(3, 6)}
        result = {}
        for part in ("rotation", "position"):
            error, rows, own = [], [], []
            for pose in poses:
                by = parts.get(part, np.concatenate([-transforms.cross_matrix(pose.found[:3, 3]), np.eye(3)], axis=1))
                error.append(by @ motion_between(pose.found, pose.true))
                rows.append(by @ pose.rows)
                own.append(by @ pose.own @ by.T)
            covariance = self._covariance(np.concatenate(rows))
            for k, each in enumerate(own):
                covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += each
            result[f"{name}, {part}"] = SquaredErrors.of(np.concatenate(error), covariance)
        return result

    def _camera(self, place: str, true: FloatArray) -> _Pose:
        (found,), (rows,), (own,) = self._adjustment.camera_rows([place])
        return _Pose(found, true, rows, own)

    def _from_tracking(self, pose: _Pose) -> _Pose:
        """Return the pose in the tracking camera's frame."""
        tracking = self._adjustment.state.device_from_tracking
        assert tracking is not None
        back = transforms.inverse(tracking)
        rows = adjoint(back) @ pose.rows
        rows[:, self._adjustment.layout.where["extrinsics", TRACKING]] -= np.eye(6)
        true = transforms.inverse(self._truth.bench.device_from_tracking) @ pose.true
        return _Pose(back @ pose.found, true, rows, adjoint(back) @ pose.own @ adjoint(back).T)

    def _board(self, number: int) -> tuple[_Pose, SquaredErrors]:
        """Return a target's pose from the features of its board, and the squared errors of its shape."""
        state, layout = self._adjustment.state, self._adjustment.layout
        board = self._bench.session.board
        index = {tuple(each): k for k, each in enumerate(board.indices())}
        shape = state.shape["board"]
        chosen = np.arange(0, len(shape.feature), max(1, len(shape.feature) // _FEATURES))
        feature, pose = shape.feature[chosen], state.targets[number]
        nominal = board.point_of(feature)
        true = self._truth.bench.printed.points[[index[tuple(each)] for each in feature]]
        turn, count = pose[:3, :3], len(chosen)
        found = transforms.apply(pose, shape.point_of(feature, nominal))
        error = transforms.apply(self._truth.bench.device_from_target[number], true) - found
        inverse, _, cross = self._adjustment.normal.features["board"]
        rows = np.zeros((count, 3, self._unknowns))
        by_motion = np.concatenate(
            [-transforms.cross_matrix(found), np.broadcast_to(np.eye(3), (count, 3, 3))], axis=-1
        )
        rows[:, :, layout.where["target", number]] = by_motion @ adjoint(pose)
        rows[:, :, layout.where["shape", "board"]] = turn @ shape.by_low(nominal)
        by_place = np.einsum("nij,unj->niu", inverse[chosen], cross.reshape(self._unknowns, -1, 3)[:, chosen])
        rows -= np.einsum("ij,nju->niu", turn, by_place)
        covariance = self._covariance(rows.reshape(3 * count, -1))
        own = np.zeros((3 * count, 3 * count))
        for k, each in enumerate(turn @ inverse[chosen] @ turn.T):
            own[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = each
        design = by_motion.reshape(-1, 6)
        rigid = np.linalg.pinv(design)
        moved = _Pose(
            pose, _moved(pose, rigid @ error.ravel()), rigid @ rows.reshape(3 * count, -1), rigid @ own @ rigid.T
        )
        rest = np.eye(3 * count) - design @ rigid
        return moved, SquaredErrors.of(rest @ error.ravel(), rest @ (covariance + own) @ rest.T)

    def _lens(self, camera: str, true: SimulatedLens) -> SquaredErrors:
        """Return the squared errors of directions over the picture, as tangents."""
        error, by_values = _tangent_errors(self._adjustment.state.lens[camera], true)
        where = self._adjustment.layout.where["lens", camera]
        rows = by_values.reshape(-1, by_values.shape[-1])
        return SquaredErrors.of(error.ravel(), rows @ self._adjustment.covariance[where, where] @ rows.T)

    def _directions(self, poses: list[_Pose]) -> SquaredErrors:
        """Return the squared errors of pixels' directions at some camera positions, in the frame of the poses."""
        lens = self._adjustment.state.lens[EYEBALL]
        error, by_values = _tangent_errors(lens, self._truth.bench.eyeball)
        pixel = _pixels(lens)
        where = self._adjustment.layout.where["lens", EYEBALL]
        tangents = lens.tangents_of_pixel(pixel)
        across = np.zeros((len(pixel), 2, 3))  # derivative of tangents by a rotation of the camera in its frame
        x, y = tangents.T
        across[:, 0], across[:, 1] = (
            np.stack([x * y, -1.0 - x**2, y], axis=-1),
            np.stack([1.0 + y**2, -x * y, -x], axis=-1),
        )
        errors, rows, own = [], [], []
        for pose in poses:
            to_camera = pose.found[:3, :3].T
            turn = to_camera @ motion_between(pose.found, pose.true)[:3]
            each = np.zeros((len(pixel), 2, self._unknowns))
            each[:, :, where] = by_values
            each -= across @ (to_camera @ pose.rows[:3])
            errors.append(error - across @ turn)
            rows.append(each.reshape(2 * len(pixel), -1))
            flat = across.reshape(-1, 3) @ to_camera
            own.append(flat @ pose.own[:3, :3] @ flat.T)
        covariance = self._covariance(np.concatenate(rows))
        for k, each in enumerate(own):
            part = slice(k * len(each), (k + 1) * len(each))
            covariance[part, part] += each
        return SquaredErrors.of(np.concatenate(errors).ravel(), covariance)

    def _travel(self) -> list[_Pose]:
        """Return the expected motion from one end of each stage axis to the other, in the camera frame at the start."""
        state = self._adjustment.state
        middle, half = state.observations.travel
        poses = []
        for axis in np.flatnonzero(half != 1.0):
            ends = []
            for sign in (-1.0, 1.0):
                reading = middle + sign * half * (np.arange(len(half)) == axis)
                places = dict(state.observations.places) | {"end": CameraPlace(reading)}
                there = replace(state, observations=replace(state.observations, places=places))
                adjustment = replace(self._adjustment, state=there)
                (found,), (rows,), _ = adjustment.camera_rows(["end"])
                full = np.zeros(3)
                full[: len(reading)] = reading
                ends.append((found, self._truth.bench.camera_at(full), rows))
            (low, true_low, low_rows), (high, true_high, high_rows) = ends
            back = transforms.inverse(low)
            rows = adjoint(back) @ (high_rows - low_rows)
            true = transforms.inverse(true_low) @ true_high
            poses.append(_Pose(back @ high, true, rows, np.zeros((6, 6))))
        return poses


def _moved(pose: FloatArray, motion: FloatArray) -> FloatArray:
    return transforms.rigid(transforms.rotations_of_vectors(motion[:3]), motion[3:]) @ pose


def _pixels(lens: Lens) -> FloatArray:
    along = [np.linspace(_EDGE, 1.0 - _EDGE, count) * size for count, size in zip(_GRID, lens.size_px, strict=True)]
    return np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 2)


def _tangent_errors(lens: Lens, true: SimulatedLens) -> tuple[FloatArray, FloatArray]:
    """Return true less fitted tangents (n, 2), and the derivative (n, 2, P) of the fitted ones by lens parameters."""
    pixel = _pixels(lens)
    tangents = lens.tangents_of_pixel(pixel)
    seen = lens.project(np.concatenate([tangents, np.ones((len(pixel), 1))], axis=1))
    by_values = -np.linalg.solve(seen.by_point[:, :, :2], seen.by_values)
    ray = true.ray_of_pixel(pixel, np.zeros(2))
    return ray[:, 3:5] / ray[:, 5:] - tangents, np.asarray(by_values, dtype=np.float64)
