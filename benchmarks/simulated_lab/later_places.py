"""Where the camera and the target of a simulated bench stand after its session."""

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import READING_DIGITS, Visit, whole_creep


def target_at(bench: PhotoBench, depth_m: float, tilt_deg: float = 0.0, shift_m: float = 0.0) -> FloatArray:
    """Return device_from_target (4, 4) of the target in front of the display's field at another depth.

    Args:
        bench: the bench.
        depth_m: depth along the middle of the view.
        tilt_deg: further rotation about the vertical axis of the view.
        shift_m: displacement to the right; half as much down.
    """
    pose, eye = bench.device_from_target[0], bench.optics.eye_box.centre
    ahead = normalised(pose[:3, 3] - eye)
    right = normalised(np.cross(ahead, [0.0, 1.0, 0.0]))
    down = np.cross(ahead, right)
    turn = transforms.rotations_of_vectors(-np.deg2rad(tilt_deg) * down)
    return transforms.rigid(turn @ pose[:3, :3], eye + depth_m * ahead + shift_m * (right + 0.5 * down))


def later_visits(bench: PhotoBench, commanded: FloatArray, rng: np.random.Generator) -> tuple[Visit, ...]:
    """Return visits of the stage to commanded positions (n, 3) after the session, with random errors as in the session.

    Axes that the stage lacks do not move. The creep keeps its value from the end of the session.
    """
    sizes, axes = bench.options.imperfections, len(bench.options.stage)
    commanded = commanded * (np.arange(3) < axes)
    place, turn, reading = 1e-6 * rng.standard_normal((3, *commanded.shape))
    position = commanded + sizes.repeatability_um * place
    stated = commanded + np.round(sizes.readback_um * reading, READING_DIGITS)
    creep = np.broadcast_to(whole_creep(bench), commanded.shape)
    error = np.concatenate([sizes.turn_jitter_urad * turn, creep], axis=1)
    error += bench.workshop_motion(commanded, np.ones(len(commanded)), sweep=1)
    return tuple(
        Visit(row[:axes], bench.camera_at(at, off)) for row, at, off in zip(stated, position, error, strict=True)
    )
