"""See-through captures of the HMD-Light-Field-Correction data set (Itoh & Klinker, TVCG 21(4), 2015).

One numbered folder per viewpoint: a camera at the eye's position photographs an asymmetric grid of circles without and
with the headset in front of it, and the headset's own camera photographs the grid too. The files are Ubitrack archives,
one line of text each. Ubitrack's frames are OpenGL's (x right, y up, looking along -z); its image rows run upwards.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.captures.session import Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.io.input_files import as_bad_input, read_text, require_length, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.optics.device_file import load_device

SIZE_PX = (1280, 1024)
FOCAL_PX = (1575.02, 1570.46)
CENTRE_FROM_BOTTOM_PX = (664.35, 513.36)
"""Calibration of the camera by its makers; the centre is counted from the middle of the bottom-left pixel."""

_SIGNATURE = ["22", "serialization::archive"]
_COUNT_AT, _VALUES_AT = 8, 12
_POSE_TOKENS, _QUATERNION, _TRANSLATION = 19, slice(10, 14), slice(16, 19)
_TIME_AT = 5
_LARGEST = 1e6  # largest number of pixels or metres
_SMOOTH_DEGREE = 3  # polynomial degree of the smooth displacement over a view
_MEDIAN_LENGTH = np.sqrt(2.0 * np.log(2.0))  # median length of a two-vector of unit normal components


@dataclass(frozen=True)
class SeeThroughPairs:
    """Dots seen by one camera without the headset and, from the same position, through the headset.

    The device frame is the frame of the headset's world-facing camera, with the axes of OpenXR; metres. Pixels have
    (0, 0) at the outer corner of the top-left pixel, v down. `v` is the number of views, `n` the number of dots.

    Attributes:
        view: (v,) folder names, in numerical order.
        size_px: width and height of the camera's image.
        focal_px, centre_px: (2,) focal lengths and centre of the camera, which has no lens distortion.
        device_from_camera: (v, 4, 4); the camera's frame is OpenCV's: x right, y down, z forward.
        device_from_target: (v, 4, 4); the dots lie in the target's plane z = 0.
        dot_in_target: (n, 3) the dots, the same in all views.
        bare_px: (v, n, 2) pixels of the dots without the headset.
        through_px: (v, n, 2) pixels of the dots through the headset.
        bare_time_s, through_time_s: (v,) times of the photographs, in seconds after the first photograph of the set.
    """

    view: tuple[str, ...]
    size_px: tuple[int, int]
    focal_px: FloatArray
    centre_px: FloatArray
    device_from_camera: FloatArray
    device_from_target: FloatArray
    dot_in_target: FloatArray
    bare_px: FloatArray
    through_px: FloatArray
    bare_time_s: FloatArray
    through_time_s: FloatArray


def read_itoh_seethrough(folder: str | Path) -> SeeThroughPairs:
    """Read all numbered view folders under `folder` (the set's `data` folder).

    Raises:
        BadInputError: the folder does not exist, a file is missing or not an archive of the expected kind, a number is
            not finite, a view's dots differ from the other views' dots, or its three poses contradict one another.
    """
    root = Path(folder)
    folders = (path.name for path in root.glob("*") if re.fullmatch("[0-9]{1,6}", path.name) and path.is_dir())
    names = sorted(folders, key=int)
    if not names:
        raise BadInputError(f"{root}: holds no numbered view folders; give the 'data' folder of the set.")
    views = [_ViewFolder.read(root / name) for name in names]
    for name, view in zip(names, views, strict=True):
        if not np.array_equal(view.dot_in_target, views[0].dot_in_target):
            raise BadInputError(f"{root / name}: its grid differs from view {names[0]}; leave this view out.")
    bare_ns, through_ns = (np.array([view.time_ns[i] for view in views]) for i in range(2))
    first_ns = min(bare_ns.min(), through_ns.min())
    return SeeThroughPairs(
        view=tuple(names),
        size_px=SIZE_PX,
        focal_px=np.array(FOCAL_PX),
        centre_px=_from_top(np.array(CENTRE_FROM_BOTTOM_PX)),
        device_from_camera=np.stack([view.device_from_camera for view in views]),
        device_from_target=np.stack([view.device_from_target for view in views]),
        dot_in_target=views[0].dot_in_target,
        bare_px=_from_top(np.stack([view.bare for view in views])),
        through_px=_from_top(np.stack([view.through for view in views])),
        # Nanoseconds since 1970 are not exact in a float, so they are subtracted first.
        bare_time_s=(bare_ns - first_ns) * 1e-9,
        through_time_s=(through_ns - first_ns) * 1e-9,
    )


def see_through_session(pairs: SeeThroughPairs) -> tuple[Bench, Session]:
    """Return pairs of photographs as a session, with the bench without optics as its nominal bench.

    A capture has its view's number and its own target pose. Its time is the time of the photograph through the headset,
    after the first of the set. The bench states the scatter of a point in both photographs together.
    """
    views, dots = pairs.through_px.shape[:2]
    camera = EyeballCamera(np.array(pairs.size_px, dtype=float), pairs.focal_px, pairs.centre_px, scatter_px(pairs))
    position = pairs.device_from_camera[:, :3, 3]
    gaps = np.linalg.norm(pairs.dot_in_target[:, None] - pairs.dot_in_target, axis=-1)
    pitch = np.full(views, gaps[gaps > 0].min())
    bench = Bench(
        load_device("no_optics"),
        "right",
        camera,
        Stage(position.mean(axis=0)),
        Target(pairs.device_from_target, pitch),
    )

    def of_view(values: FloatArray) -> FloatArray:
        return np.repeat(values, dots, axis=0)

    turn_from_opencv = np.diag([1.0, -1.0, -1.0])
    plan = SeeThroughPlan(
        capture=np.repeat([int(view) for view in pairs.view], dots),
        time_s=of_view(pairs.through_time_s),
        travel=np.ones(views * dots),
        stage=of_view(position),
        target_pose=np.repeat(np.arange(views), dots),
        dot=np.tile(pairs.dot_in_target[:, :2], (views, 1)),
        orientation=of_view(pairs.device_from_camera[:, :3, :3] @ turn_from_opencv),
        bare_pixel=pairs.bare_px.reshape(-1, 2),
    )
    return bench, Session(
        "itoh-seethrough", SessionPlan(see_through=plan), Readings(dot_pixel=pairs.through_px.reshape(-1, 2))
    )


def scatter_px(pairs: SeeThroughPairs) -> float:
    """Return the scatter per axis of the dots' displacements by the headset about a smooth surface over each view.

    It is the median over views of an estimate from the median length in each view, so that a few misdetected dots have
    little effect.
    """
    sigmas = []
    for bare, through in zip(pairs.bare_px, pairs.through_px, strict=True):
        design = basis(bare, total_degree(2, _SMOOTH_DEGREE), Box.around(bare))
        displacement = through - bare
        left = displacement - design @ np.linalg.lstsq(design, displacement, rcond=None)[0]
        freedom = len(bare) / (len(bare) - design.shape[1])
        sigmas.append(np.sqrt(freedom) * np.median(np.linalg.norm(left, axis=1)) / _MEDIAN_LENGTH)
    return float(np.median(sigmas))


def _from_top(pixel_from_bottom: FloatArray) -> FloatArray:
    """Convert pixels (..., 2), rows upwards from pixel centres, to our pixels, rows downwards from the outer corner."""
    u, v = np.moveaxis(pixel_from_bottom, -1, 0)
    return np.stack([u + 0.5, SIZE_PX[1] - (v + 0.5)], axis=-1)


@dataclass(frozen=True)
class _ViewFolder:
    """One folder, with pixels still counted from the bottom."""

    device_from_camera: FloatArray
    device_from_target: FloatArray
    dot_in_target: FloatArray
    bare: FloatArray
    through: FloatArray
    time_ns: tuple[int, int]

    @classmethod
    def read(cls, folder: Path) -> "_ViewFolder":
        bare_file, through_file = folder / "2dPointsOnViewPoint.txt", folder / "2dPointsOnViewPointThroughHMD.txt"
        dots, bare, through = _points(folder / "3dPointsOnGrid.txt", 3), _points(bare_file, 2), _points(through_file, 2)
        require_length(f"{folder / '3dPointsOnGrid.txt'}: the grid", dots, 10.0)
        if not len(dots) == len(bare) == len(through):
            raise BadInputError(
                f"{folder}: {len(dots)} dots on the grid, {len(bare)} seen without and {len(through)} through the "
                "headset; the three must be equal, leave this view out."
            )
        device_from_gl_camera = _pose(folder / "P_HMDCam2IDS.txt")
        device_from_target = _pose(folder / "P_HMDCam2Marker.txt")
        via_camera = device_from_gl_camera @ _pose(folder / "P_IDS2Marker.txt")
        if not np.allclose(via_camera, device_from_target, atol=1e-6):
            raise BadInputError(f"{folder}: P_HMDCam2Marker is not P_HMDCam2IDS * P_IDS2Marker; leave this view out.")
        gl_from_cv = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
        times = (int(_tokens(bare_file)[_TIME_AT]), int(_tokens(through_file)[_TIME_AT]))
        return cls(device_from_gl_camera @ gl_from_cv, device_from_target, dots, bare, through, times)


def _tokens(path: Path) -> list[str]:
    tokens = read_text(path, "a text archive").split()
    if tokens[:2] != _SIGNATURE or len(tokens) < _VALUES_AT or not re.fullmatch(r"[0-9]{1,19}", tokens[_TIME_AT]):
        raise BadInputError(f"{path}: does not start as a text archive, '22 serialization::archive ... time'.")
    return tokens


def _numbers(path: Path, tokens: list[str]) -> FloatArray:
    with as_bad_input(path, "numbers", "leave this view out"):
        values = np.array(tokens, dtype=np.float64)
    if not np.all(np.abs(values) < _LARGEST):
        raise BadInputError(f"{path}: holds a number that is not finite, or is {_LARGEST:g} or more; correct it.")
    return values


def _points(path: Path, columns: int) -> FloatArray:
    """Read a measured list of points, (n, columns)."""
    tokens = _tokens(path)
    values = _numbers(path, tokens[_VALUES_AT:])
    if not re.fullmatch(r"[0-9]{1,9}", tokens[_COUNT_AT]) or len(values) != int(tokens[_COUNT_AT]) * columns:
        raise BadInputError(
            f"{path}: says {shown(tokens[_COUNT_AT])} points of {columns} numbers and holds {len(values)} numbers; "
            "download the file again."
        )
    return values.reshape(-1, columns)


def _pose(path: Path) -> FloatArray:
    """Read a measured pose, (4, 4): quaternion xyzw, two more archive tokens, translation."""
    tokens = _tokens(path)
    if len(tokens) != _POSE_TOKENS:
        raise BadInputError(f"{path}: has {len(tokens)} tokens, a pose has {_POSE_TOKENS}; download it again.")
    quaternion, translation = _numbers(path, tokens[_QUATERNION]), _numbers(path, tokens[_TRANSLATION])
    require_length(f"{path}: the translation", translation, 100.0)
    length = np.linalg.norm(quaternion)
    if abs(length - 1.0) > 1e-6:
        raise BadInputError(f"{path}: its quaternion has the length {length:.6g}, not 1; download the file again.")
    return transforms.rigid(transforms.rotation_of_quaternion(quaternion), translation)
