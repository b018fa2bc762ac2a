"""SPAAM sittings of one wearer with tracked eye positions (YutaItoh/HMD-Calibration; Itoh and Klinker, 3DUI 2014).

A sitting is some twenty alignments of a crosshair with a real marker, and the eye positions that a tracker camera on
the headset saw meanwhile. All data are in the frame of the headset's world camera: OpenGL axes (x right, y up, looking
along -z), metres.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rotation_of_quaternion
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray

_BASE = "Base"
_POSE_TOKENS, _QUATERNION, _TRANSLATION = 19, slice(10, 14), slice(16, 19)
_UPSIDE_DOWN = np.array([1.0, -1.0, -1.0])  # the authors' program rotates the stored screen like this
_STEPS = 20


@dataclass(frozen=True)
class Sitting:
    """Alignments of one sitting.

    Attributes:
        name: name of the folder.
        pixel: (n, 2) pixels of the crosshair, rows downwards or upwards as in the set.
        point: (n, 3) positions of the marker.
        eye: (3,) tracked position of the eye.
        eye_spread: mean distance of the tracked positions from `eye`, summed over the axes.
    """

    name: str
    pixel: FloatArray
    point: FloatArray
    eye: FloatArray
    eye_spread: float


@dataclass(frozen=True)
class Screen:
    """The virtual image as the authors calibrated it with a camera.

    Attributes:
        panel: pixels of the screen.
        px_per_m: pixels per metre on the image.
        rotation: (3, 3) and translation (3,) from the world camera's frame to the screen's, in which the image is the
            plane z = 0.
    """

    panel: Panel
    px_per_m: float
    rotation: FloatArray
    translation: FloatArray


@dataclass(frozen=True)
class Alignments:
    """All sittings, the one that the authors calibrate with first, and the screen."""

    sittings: tuple[Sitting, ...]
    screen: Screen


def read_itoh_alignments(folder: str | Path) -> Alignments:
    """Read the folder `dataset` of the set.

    Raises:
        BadInputError: a file is missing or has unexpected content.
    """
    root = Path(folder)
    names = sorted((path.name for path in root.glob("*") if path.name.isdigit()), key=int)
    if not (root / _BASE).is_dir() or not names:
        raise BadInputError(f"{root}: holds no folders Base, 1, 2 ...; give the folder 'dataset' of the set.")
    rotation, translation = _pose(root / "PoseFromEyeCam2WorldCam.txt")
    sittings = [_sitting(root / name, rotation, translation) for name in (_BASE, *names)]
    return Alignments(tuple(sittings), _screen(root / "display_param_linear.mat"))


def _sitting(folder: Path, rotation: FloatArray, translation: FloatArray) -> Sitting:
    pixel = _table(folder / "MarkerSPAAM_DataSPAAM2D.txt", 2)
    point = _table(folder / "MarkerSPAAM_DataSPAAM3D.txt", 3)
    if len(pixel) != len(point):
        raise BadInputError(f"{folder}: {len(pixel)} pixels and {len(point)} points; there must be as many of each.")
    candidates = _table(folder / "eye_positions.txt", 3)
    if len(candidates) < 2:
        raise BadInputError(f"{folder}: has no pair of eye positions; leave this sitting out.")
    place, spread = _tracked(candidates[: len(candidates) // 2 * 2].reshape(-1, 2, 3))
    in_tracker = place * [1.0, 1.0, -1.0]  # the tracker states distances along its viewing direction, -z
    return Sitting(folder.name, pixel, point, (in_tracker - translation) @ rotation, spread)


def _tracked(pairs: FloatArray) -> tuple[FloatArray, float]:
    """Return the position (3,) of the eye, and the spread about this position.

    The outline of an iris has two possible positions (k, 2, 3). The correct positions of all images form a cluster:
    with every position as a start, choose the median that is closest to the nearer position of each pair.
    """
    best = (np.inf, pairs[0, 0])
    for start in pairs.reshape(-1, 3):
        centre = start
        for _ in range(_STEPS):
            nearer = np.argmin(np.linalg.norm(pairs - centre, axis=2), axis=1)
            chosen = pairs[np.arange(len(pairs)), nearer]
            centre = np.median(chosen, axis=0)
        spread = float(np.abs(chosen - centre).sum(axis=1).mean())
        if spread < best[0]:
            best = (spread, centre)
    return best[1], best[0]


def _screen(path: Path) -> Screen:
    try:
        stored = loadmat(path)
        width, height, density = (float(stored[key].item()) for key in ("w", "h", "alpha"))
        rotation, translation = np.asarray(stored["R_WS"], np.float64), np.asarray(stored["t_WS"], np.float64)
        turned = rotation.reshape(3, 3) * _UPSIDE_DOWN[:, None], translation.reshape(3) * _UPSIDE_DOWN
    except (OSError, KeyError, ValueError, MatReadError) as error:
        raise BadInputError(f"{path}: holds no calibrated display ({error}); download it again.") from error
    return Screen(Panel(int(width), int(height)), density, *turned)


def _table(path: Path, columns: int) -> FloatArray:
    try:
        values = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path}: is not a table of numbers ({error}); download it again.") from error
    if values.shape[1:] != (columns,) or not np.isfinite(values).all():
        raise BadInputError(f"{path}: must hold lines of {columns} finite numbers.")
    return values


def _pose(path: Path) -> tuple[FloatArray, FloatArray]:
    try:
        tokens = path.read_text(encoding="ascii").split()
        numbers = np.array([float(each) for each in tokens[2:]])
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise BadInputError(f"{path}: is not a pose ({error}); download it again.") from error
    if len(tokens) != _POSE_TOKENS:
        raise BadInputError(f"{path}: has {len(tokens)} tokens, a pose has {_POSE_TOKENS}; download it again.")
    values = np.concatenate([np.zeros(2), numbers])
    return rotation_of_quaternion(values[_QUATERNION]), values[_TRANSLATION]
