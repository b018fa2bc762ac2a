"""Diagnoses put together by hand around real observations, for tests of what is told of them."""

from dataclasses import replace

import numpy as np
from oracle.captures import Plan
from oracle.effects import draw_effect
from oracle.session_writer import write_session

from wlr_render.captures.session import Readings, RunTimePlan, Session, SessionPlan
from wlr_render.diagnosis import figures
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    Correction,
    DetectionLimit,
    Diagnosis,
    FoundCause,
    Overlap,
    ParameterValue,
    Rival,
    Unexplained,
)
from wlr_render.diagnosis.extension import Extension, Hypothesis, Predictor
from wlr_render.diagnosis.fit import fit
from wlr_render.diagnosis.held_out import HeldOutGain
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import PART_NAMES, observe
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.simulation.bench import Clock
from wlr_render.simulation.session_folder import load_session
from wlr_render.simulation.simulate_session import simulate

SEPARATED_BY = "a ruler on the print"
RIVAL = "tracking_translation"
RIVAL_BEHIND = 812.5


def measured(folder, *effects):
    """Bench and session of a small measured northstar with effects of these names hidden in it."""
    rng = np.random.default_rng(3)
    write_session(folder, Plan(grid=(12, 9), dots=(9, 6)), [draw_effect(name, rng) for name in effects], rng)
    return load_session(folder)


def ran(nominal, latency_ms=11.0):
    """A session of the same headset while it runs, with a latency."""
    rng, count = np.random.default_rng(5), 300
    ahead = np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), np.full(count, -1.0)])
    viewpoint = nominal.optics.eye_box.centre + rng.normal(0, 5e-4, (count, 3))
    plan = RunTimePlan(
        capture=np.arange(count) // 30,
        time_s=0.1 * np.arange(count),
        world_from_device=np.broadcast_to(np.eye(4), (count, 4, 4)),
        head_velocity=np.zeros((count, 3)),
        head_rate=rng.normal(0, 0.5, (count, 3)),
        viewpoint=viewpoint,
        gaze=ahead / np.linalg.norm(ahead, axis=1, keepdims=True),
        dot=viewpoint + rng.uniform(0.5, 2.0, (count, 1)) * ahead,
    )
    late = replace(nominal, clock=Clock(latency_s=1e-3 * latency_ms))
    seen = simulate(late, SessionPlan(run_time=plan)).seen + rng.normal(0, 7e-5, (count, 4))
    return Session("ran", SessionPlan(run_time=plan), Readings(seen=seen))


def explained(nominal, session, *names):
    """A session explained by causes of these names; their values are fitted, the rest of the evidence is invented."""
    observations = observe(nominal, session)
    predictor, extension = Predictor(observations), Extension()
    used = np.ones(len(observations), dtype=bool)
    before = predictor.residual(extension)
    for name in names:
        extension = extension.plus(Hypothesis(CAUSES[name], next(iter(CAUSES[name].variants))))
    found = fit(predictor, extension, used)
    sigmas = np.split(found.sigmas(), np.cumsum([len(v) for v in found.extension.values])[:-1])
    causes = tuple(_cause(*each) for each in zip(names, found.extension.values, sigmas, strict=True))
    present = sorted(set(observations.part.tolist()))
    return Diagnosis(
        verdict=EXPLAINED,
        causes=causes,
        outliers=(),
        floors=tuple(NoiseFloor(PART_NAMES[part], 0.1, 0.0991, np.nan, 0.0991, 0.001, 0.1) for part in present),
        noise=figures.of_noise(observations, used),
        before=figures.of_residual(observations, before, used),
        after=figures.of_residual(observations, found.residual, used),
        unexplained=None,
        limits=(),
        reasons=("held-out captures gain 0.4 standard errors only",),
        observations=observations,
        residual_before=before,
        residual_after=found.residual,
        used=used,
        extended=found.extension.bench(nominal),
    )


def partly(diagnosis):
    """With something left, one capture moved, a stated noise that is wrong, and a rival hard on each cause's heels."""
    observations = diagnosis.observations
    moved = MovedCapture(observations.captures[3], (0.41, -0.72, 0.13), (0.05, 0.26, -0.07), 9.5, 1.02)
    gains = [("panel pixels", HeldOutGain(31.4, 2.2, 8.6)), ("time", HeldOutGain(-1.3, 0.4, -3.1))]
    left = Unexplained(
        "display", "panel pixels", 2.37, tuple(Correction("display", b, "smooth", 9, g) for b, g in gains)
    )
    floor = NoiseFloor("display", 0.05, 0.0931, np.nan, 0.0931, 0.001, 0.0931)
    doubtful = [replace(c, rivals=(c.rivals[0], replace(c.rivals[1], cost_behind=1.5))) for c in diagnosis.causes]
    return replace(
        diagnosis,
        verdict=PARTLY,
        causes=tuple(doubtful),
        outliers=(moved,),
        unexplained=left,
        floors=(floor, *diagnosis.floors[1:]),
        used=observations.group != 3,
    )


def nothing(diagnosis):
    """No effect."""
    limits = (DetectionLimit("target_scale", "scale_x", "%", 0.0123), DetectionLimit("latency", "latency", "ms", 0.456))
    return replace(
        diagnosis,
        verdict=NO_EFFECT,
        causes=(),
        limits=limits,
        after=diagnosis.before,
        residual_after=diagnosis.residual_before,
        extended=diagnosis.observations.nominal,
    )


def _cause(name, values, sigmas):
    cause = CAUSES[name]
    variant = next(iter(cause.variants))
    rows = zip(cause.parameters, values, sigmas, strict=True)
    parameters = tuple(ParameterValue(p.name, float(v), float(s), p.unit, p.plausible) for p, v, s in rows)
    rivals = (Rival(name, variant, 1.004, 0.0), Rival(RIVAL, "as a whole", 3.21, RIVAL_BEHIND))
    overlaps = (Overlap(RIVAL, 0.9876, SEPARATED_BY),)
    gain = HeldOutGain(80.87, 1.23, 14.5)
    return FoundCause(name, cause.title, cause.part, variant, parameters, gain, overlaps, rivals, 5.25)
