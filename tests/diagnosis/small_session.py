"""A session small enough to be fitted in a fraction of a second, yet one that tells the causes apart."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from present import present

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import (
    DisplayPlan,
    RunTimePlan,
    SeeThroughPlan,
    Session,
    SessionPlan,
)
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.noise import Noise, NoiseFloor
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter
from wlr_render.optics.device_file import load_device

SIGMA_PX = 0.1
SECONDS = 60.0
"""From one capture to the next."""


def small_bench() -> Bench:
    """Project North Star before a camera of 1.2 arcminutes per pixel, and a target at two distances."""
    device = load_device("northstar")
    middle = device.eyes["right"].eye_box.centre
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([900.0, 900.0]), np.array([640.0, 300.0]), SIGMA_PX)
    # Askew, so that the target's axes are not those of the device.
    turn = rotations_of_vectors(np.array([[0.1, -0.2, 0.05], [-0.1, 0.15, 0.0]]))
    poses = rigid(turn, middle + np.array([[0.0, -0.08, -0.5], [0.02, -0.2, -1.2]]))
    return Bench(device, "right", camera, Stage(middle), Target(poses, np.array([0.03, 0.07])))


def stage_positions() -> tuple[FloatArray, FloatArray]:
    """(18, 3) offsets and (18,) directions of the last move; the first two places are visited again at the end."""
    offsets = np.array([[x, y, z] for z in (-3, 3) for y in (-3, 3) for x in (-4, -1.5, 1.5, 4)]) * 1e-3
    offsets[4:8], offsets[12:] = offsets[7:3:-1], offsets[15:11:-1]
    travel = np.repeat([1.0, -1.0, 1.0, -1.0], 4)
    return np.concatenate([offsets, offsets[:2]]), np.append(travel, travel[:2])


def small_plan(bench: Bench) -> SessionPlan:
    """Display and see-through readings: 18 captures of 56 points, and 2 times 9 of 49 dots."""
    offsets, travel = stage_positions()
    place = bench.stage.origin + offsets
    u, v = np.meshgrid(np.linspace(330, 950, 8), np.linspace(200, 900, 7))
    grid = np.stack([u, v], axis=-1).reshape(-1, 2)
    capture = np.repeat(np.arange(len(place)), len(grid))
    # The places that are visited again show the same colour as before.
    channel = np.append(np.arange(16), [0, 1])[capture] % 3
    display = DisplayPlan(
        capture, np.asarray(SECONDS * capture), travel[capture], place[capture], channel, np.tile(grid, (len(place), 1))
    )
    return SessionPlan(display, _see_through(bench, place[::2], travel[::2]))


def _see_through(bench: Bench, place: FloatArray, travel: FloatArray) -> SeeThroughPlan:
    x, y = np.meshgrid(np.arange(-3, 4), np.arange(-3, 4))
    dots = np.stack([x, y], axis=-1).reshape(-1, 2)
    poses = len(bench.target.pitch)
    pose, capture = (np.repeat(each.ravel(), len(dots)) for each in np.indices((poses, len(place))))
    time_s = SECONDS * (18 + pose * len(place) + capture)
    dot = np.tile(dots, (poses * len(place), 1)) * bench.target.pitch[pose][:, None]
    return SeeThroughPlan(capture, np.asarray(time_s), travel[capture], place[capture], pose, dot)


def run_time_plan(
    bench: Bench, rows: int = 160, captures: int = 8, distance_m: tuple[float, float] = (0.4, 3.0)
) -> RunTimePlan:
    """Run-time readings while the head turns: dots in the display's field at several distances."""
    rng = np.random.default_rng(21)
    viewpoint = bench.stage.origin + rng.uniform(-2e-3, 2e-3, (rows, 3))
    gaze = dir_of_tangents(rng.uniform([-0.25, -0.5], [0.3, 0.1], (rows, 2)))
    head = rigid(rotations_of_vectors(rng.normal(0, 0.5, (rows, 3))), rng.normal(0, 1, (rows, 3)))
    in_device = viewpoint + rng.uniform(*distance_m, (rows, 1)) * gaze
    dot = np.einsum("nij,nj->ni", head[:, :3, :3], in_device) + head[:, :3, 3]
    capture = np.arange(rows) * captures // rows
    velocity, rate = rng.normal(0, 0.2, (rows, 3)), rng.normal(0, 0.6, (rows, 3))
    return RunTimePlan(capture, np.asarray(0.1 * np.arange(rows)), head, velocity, rate, viewpoint, gaze, dot)


def hypothesis(name: str, variant: int = 0) -> Hypothesis:
    """A cause acting in one of its ways, by number."""
    return Hypothesis(CAUSES[name], list(CAUSES[name].variants)[variant])


def explanation(**values: ArrayLike) -> Explanation:
    """Causes by name at values, each in its usual way."""
    names = tuple(hypothesis(name) for name in values)
    return Explanation(names, tuple(np.asarray(each, dtype=float) for each in values.values()))


def measured(bench: Bench, plan: SessionPlan, sigma_px: float = 0.0, seed: int = 0, **causes: Any) -> Observations:
    """Observations of a session read by a bench with causes at work (name=values), with noise of camera pixels."""
    read = simulate(explanation(**causes).bench(bench), plan)
    observations = Predictor.of_session(bench, Session("small", plan, read)).observations
    return with_noise(observations, sigma_px, np.random.default_rng(seed))


def with_noise(observations: Observations, sigma_px: float, rng: np.random.Generator) -> Observations:
    """The same observations with more noise in every part."""
    read = observations.session.readings
    changes = {}
    if read.panel_pixel is not None:
        kick = rng.normal(0, sigma_px, (*read.panel_pixel.shape, 1))
        changes["panel_pixel"] = read.panel_pixel + np.linalg.solve(observations.camera_from_panel, kick)[:, :, 0]
    if read.dot_pixel is not None:
        changes["dot_pixel"] = read.dot_pixel + rng.normal(0, sigma_px, read.dot_pixel.shape)
    if read.run_time_pixel is not None:
        changes["run_time_pixel"] = read.run_time_pixel + rng.normal(0, sigma_px, read.run_time_pixel.shape)
    return with_readings(observations, **changes)


def with_readings(observations: Observations, **changes: Any) -> Observations:
    """Observations with other readings."""
    session = observations.session
    return replace(observations, session=replace(session, readings=replace(session.readings, **changes)))


def weighed(observations: Observations, shared: float = 0.0, reach_px: float = float("nan")) -> WeighedReadings:
    """Readings whose noise is as stated, and of which neighbours share a part."""
    numbers = (SIGMA_PX, SIGMA_PX, float("nan"), SIGMA_PX, 0.0, SIGMA_PX)
    floors = tuple(
        NoiseFloor(PART_NAMES[part], *numbers, True, shared=shared, shared_reach_px=reach_px)
        for part in np.unique(observations.part)
    )
    noise = Noise(floors, observations.sigma_px, np.zeros(len(observations), dtype=bool))
    return WeighedReadings.of(Predictor(observations), noise)


def scatter_of(
    observations: Observations, shift_um: float = 0.0, turn_urad: float = 0.0, moved: tuple[int, ...] = ()
) -> Scatter:
    """Noise as stated, motions of one size in all parts, and the captures that moved by number."""
    ones = np.ones(len(PART_NAMES))
    names = np.isin(np.arange(len(observations.captures)), moved)
    return Scatter(ones, (shift_um + 1e-6) * ones, (turn_urad + 1e-6) * ones, names)


def fitted_at_rest(observations: Observations, start: Explanation, **options: Any) -> Fit | None:
    """A fit where the camera is known to repeat exactly, and noise to be as stated."""
    return fit(weighed(observations), start, scatter_of(observations), vary_scatter=False, **options)


def fitted(observations: Observations, start: Explanation, **options: Any) -> Fit | None:
    """A fit that finds the sizes of what is random, from those of an ordinary bench on."""
    return fit(weighed(observations), start, Scatter.usual(len(observations.captures)), **options)


def with_moved_capture(observations: Observations, bench: Bench, number: int) -> Observations:
    """One capture read by a camera that stands and looks elsewhere."""
    motions = np.zeros((len(observations.captures), 6))
    motions[number] = [500.0, -400.0, 300.0, *(1e6 * np.radians([0.1, -0.1, 0.2]))]
    return with_motions(observations, bench, motions)


def with_jitter(
    observations: Observations,
    bench: Bench,
    shift_um: float,
    rng: np.random.Generator,
    turn_urad: float = 0.0,
    dof: float = np.inf,
) -> Observations:
    """The same readings by a camera that stands and looks elsewhere in each capture, by normal or Student's motions."""
    captures = len(observations.captures)
    kicks = rng.normal(size=(captures, 6)) * np.repeat([shift_um, turn_urad], 3)
    if np.isfinite(dof):
        # Of the same variance, with tails: a random size for each motion.
        kicks *= np.sqrt((dof - 2.0) / rng.chisquare(dof, (captures, 1)))
    return with_motions(observations, bench, kicks)


def with_motions(observations: Observations, bench: Bench, motions: FloatArray) -> Observations:
    """The same readings by a camera that moves by (captures, 6) micrometres and microradians."""
    plan, read = observations.session.plan, observations.session.readings
    panel, dots = present(read.panel_pixel).copy(), present(read.dot_pixel).copy()
    here = simulate(bench, plan)
    for number in np.flatnonzero(np.any(motions != 0.0, axis=1)):
        shift, turn = 1e-3 * motions[number, :3], np.degrees(1e-6 * motions[number, 3:])
        rows = observations.group == number
        mine = observations.of_rows(rows).session.plan
        there = simulate(explanation(camera_pupil_offset=shift, camera_rotation=turn).bench(bench), mine)
        shown, seen = rows[observations.part == DISPLAY], rows[observations.part == SEE_THROUGH]
        if shown.any():
            panel[shown] += there.panel_pixel - present(here.panel_pixel)[shown]
        if seen.any():
            dots[seen] += there.dot_pixel - present(here.dot_pixel)[seen]
    return with_readings(observations, panel_pixel=panel, dot_pixel=dots)


def diagnosed(observations: Observations, names: tuple[str, ...]) -> Diagnosis:
    """A whole diagnosis with a few causes, so that it is quick."""
    causes = {name: CAUSES[name] for name in names}
    return diagnose(observations.nominal, observations.session, causes=causes, settings=Settings(subsample=1200))


def explained() -> Diagnosis:
    """Diagnose a session with a tilted combiner, a target printed too large, and a display capture that moved."""
    bench = small_bench()
    truth = {"combiner_tilt": [0.3, -0.2, 0.3], "target_scale": [0.3, 0.3]}
    observations = with_moved_capture(measured(bench, small_plan(bench), SIGMA_PX, seed=4, **truth), bench, 3)
    return diagnosed(observations, ("combiner_tilt", "target_scale", "tracking_translation", "panel_shift"))


def located() -> Diagnosis:
    """Diagnose a session whose panel is bent in waves, and whose noise is twice what is stated."""
    bench = small_bench()
    observations = measured(bench, small_plan(bench), 2 * SIGMA_PX, seed=5)
    read = observations.session.readings
    present(read.panel_pixel)[:, 0] += 4.0 * np.sin(2 * np.pi * present(read.panel_pixel)[:, 0] / 500)
    return diagnosed(observations, ("target_scale", "stage_scale"))
