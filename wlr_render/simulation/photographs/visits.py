"""True camera poses of a simulated session: one for each visit of the stage to a commanded position."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import PhotoPlan, stage_axis_count
from wlr_render.simulation.viewpoints import random_in_eye_box

_PLACES, _TURNS, _READINGS, _CREEP, _HAND = range(17, 22)  # streams of random numbers
_CREEP_TIME = 0.3  # of the session, in which the creep falls to 1 / e
_HAND_TURN_DEG = 1.5  # of each axis, standard deviation
_READING_DIGITS = 8  # of metres: an encoder of 10 nm


@dataclass(frozen=True, eq=False)
class Visit:
    """The camera at one place, from arriving until leaving.

    Attributes:
        reading: (m,) what the encoders of the stage say, metres; None for a camera in the hand.
        device_from_camera: (4, 4) where the eyeball camera really is.
        place: name of the place of a camera in the hand; "" on a stage.
    """

    reading: FloatArray | None
    device_from_camera: FloatArray
    place: str = ""


@dataclass(frozen=True, eq=False)
class SessionVisits:
    """The visits of a session, in the order of the lists of its session.toml.

    Attributes:
        bare: one for each photograph of the target without the headset.
        see_through: one for each photograph of the target through the optics.
        display: one for each panel set; these are the visits of the first target pose's photographs.
    """

    bare: tuple[Visit, ...]
    see_through: tuple[Visit, ...]
    display: tuple[Visit, ...]


def true_camera_poses(bench: PhotoBench, plan: PhotoPlan) -> SessionVisits:
    """The visits of a session, from the bench's seed.

    The stage travels through the bare positions of the first target pose, the sweep of each target pose with a return
    to its first position, and the bare positions of the other bare target pose. It creeps in this order. A hand holds
    the camera anywhere in the eye box, at as many places for each target pose.
    """
    axes = stage_axis_count(bench)
    if not axes:
        return _visits_by_hand(bench, len(plan.sweep))
    sweep = np.concatenate([plan.sweep, plan.sweep[:1]])
    poses, places, bare = len(bench.device_from_target), len(plan.sweep), len(plan.bare)
    commanded = np.concatenate([np.tile(plan.bare, (len(plan.bare_poses), 1)), np.tile(sweep, (poses, 1))])
    bare_count = bare * len(plan.bare_poses)
    taken = np.concatenate([np.arange(bare), np.arange(bare, bare_count) + poses * len(sweep)])
    taken = np.concatenate([taken, bare + np.arange(poses * len(sweep))])
    # In this order since the first sessions were simulated with the first sweep and the bare visits alone.
    drawn = np.concatenate([bare_count + np.arange(places), np.arange(bare_count)])
    drawn = np.concatenate([drawn, np.arange(bare_count + places, len(commanded))])

    sizes, seed, left = bench.options.imperfections, bench.options.seed, int(bench.eye == "left")
    place, turn, reading, creep = (
        np.random.default_rng([seed, stream, left]) for stream in (_PLACES, _TURNS, _READINGS, _CREEP)
    )
    position = commanded.copy()
    position[drawn] += place.normal(0.0, 1e-6 * sizes.repeatability_um, commanded.shape)
    direction = creep.standard_normal(3)
    error = np.concatenate([turn.normal(0.0, 1e-6 * sizes.turn_jitter_urad, commanded.shape), commanded * 0.0], axis=1)
    error[:, 3:] = np.outer(_creep(taken), 1e-6 * sizes.creep_um * direction / np.linalg.norm(direction))
    stated = commanded + np.round(reading.normal(0.0, 1e-6 * sizes.readback_um, commanded.shape), _READING_DIGITS)
    visits = tuple(
        Visit(own[:axes], bench.camera_at(at, off)) for own, at, off in zip(stated, position, error, strict=True)
    )
    through = visits[bare_count:]
    return SessionVisits(visits[:bare_count], through, through[:places])


def _visits_by_hand(bench: PhotoBench, count: int) -> SessionVisits:
    rng = np.random.default_rng([bench.options.seed, _HAND, int(bench.eye == "left")])
    visits = []
    for pose in range(len(bench.device_from_target)):
        for number, viewpoint in enumerate(random_in_eye_box(bench.optics.eye_box, count, rng)):
            turn = transforms.rotations_of_vectors(np.deg2rad(_HAND_TURN_DEG) * rng.standard_normal(3))
            pose_of_hand = transforms.rigid(turn @ bench.device_from_camera[:3, :3], viewpoint)
            visits.append(Visit(None, pose_of_hand, f"target {pose}, place {number}"))
    return SessionVisits((), tuple(visits), tuple(visits[:count]))


def _creep(taken: FloatArray) -> FloatArray:
    """(n,) part of the whole creep at the photographs number `taken` (n,)."""
    part = 1.0 - np.exp(-taken / (_CREEP_TIME * max(1, len(taken) - 1)))
    return np.asarray(part / (1.0 - np.exp(-1.0 / _CREEP_TIME)))
