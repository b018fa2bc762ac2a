"""A diagnosis as strict JSON: docs/diagnosis.md has the keys."""

import json
import math
from typing import Any

from wlr_render.diagnosis.diagnosis import Diagnosis, Figures, FoundCause, ParameterValue, Unexplained
from wlr_render.diagnosis.gain import Gains, Rendered
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import PART_NAMES
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.refit import Refitted
from wlr_render.diagnosis.report_text import advice, verdict_sentence, warnings

FORMAT = "wlr-diagnosis"
VERSION = 1


def report_json(diagnosis: Diagnosis, gains: Gains | None = None) -> str:
    """The whole record as one JSON text; what is not finite becomes null."""
    record = _record(diagnosis) | {"gains": None if gains is None else _gains(gains)}
    return json.dumps(_finite(record), indent=2, allow_nan=False) + "\n"


def _record(diagnosis: Diagnosis) -> dict[str, Any]:
    observations = diagnosis.observations
    return {
        "format": FORMAT,
        "version": VERSION,
        "session": observations.session.name,
        "device": observations.nominal.device.name,
        "eye": observations.nominal.eye,
        "readings": len(observations),
        "captures": len(observations.captures),
        "verdict": diagnosis.verdict,
        "sentence": verdict_sentence(diagnosis),
        "advice": advice(diagnosis),
        "warnings": warnings(diagnosis),
        "causes": [_cause(cause) for cause in diagnosis.causes],
        "condition": diagnosis.condition,
        "outliers": [moved.capture.capture for moved in diagnosis.outliers],
        "outlier_captures": [_outlier(moved) for moved in diagnosis.outliers],
        "before": _figures(diagnosis.before, diagnosis.noise),
        "after": _figures(diagnosis.after, diagnosis.noise),
        "unexplained": None if diagnosis.unexplained is None else _unexplained(diagnosis.unexplained),
        "noise": [_noise(floor) for floor in diagnosis.floors],
        "detection_limits": [
            {"cause": limit.cause, "parameter": limit.parameter, "unit": limit.unit, "smallest": limit.smallest}
            for limit in diagnosis.limits
        ],
        "reasons": list(diagnosis.reasons),
    }


def _parameter(parameter: ParameterValue) -> dict[str, Any]:
    return {
        "value": parameter.value,
        "sigma": parameter.sigma,
        "unit": parameter.unit,
        "plausible": parameter.plausible,
    }


def _cause(cause: FoundCause) -> dict[str, Any]:
    return {
        "name": cause.name,
        "title": cause.title,
        "part": cause.part,
        "variant": cause.variant,
        "parameters": {
            p.name: {"value": p.value, "sigma": p.sigma, "unit": p.unit, "plausible": p.plausible}
            for p in cause.parameters
        },
        "held_out_gain": cause.gain.percent,
        "gain_sigma": cause.gain.sigma,
        "gain_significance": cause.gain.significance,
        "effect_over_noise": cause.effect_over_noise,
        "overlaps_with": [overlap.name for overlap in cause.overlaps],
        "overlaps": [
            {"name": overlap.name, "cosine": overlap.cosine, "separated_by": overlap.separated_by}
            for overlap in cause.overlaps
        ],
        "rivals": [
            {"name": rival.name, "variant": rival.variant, "misfit": rival.misfit, "cost_behind": rival.cost_behind}
            for rival in cause.rivals
        ],
    }


def _outlier(moved: MovedCapture) -> dict[str, Any]:
    name = moved.capture
    return {
        "part": PART_NAMES[name.part],
        "target_pose": None if name.target_pose < 0 else name.target_pose,
        "capture": name.capture,
        "shift_mm": moved.shift_mm,
        "turn_deg": moved.turn_deg,
        "rms_over_noise": moved.rms_before,
        "rms_over_noise_if_moved": moved.rms_after,
    }


def _figures(figures: Figures, noise: Figures) -> dict[str, float | None]:
    return {
        "display_rms_px": figures.display_rms_px,
        "display_noise_floor_px": noise.display_rms_px,
        "seethrough_rms_arcmin": figures.see_through_rms_arcmin,
        "seethrough_noise_floor_arcmin": noise.see_through_rms_arcmin,
        "runtime_rms_arcmin": figures.run_time_rms_arcmin,
        "runtime_noise_floor_arcmin": noise.run_time_rms_arcmin,
        "rms_over_noise": figures.over_noise,
    }


def _unexplained(left: Unexplained) -> dict[str, Any]:
    corrections = [
        {
            "bound_to": correction.bound_to,
            "form": correction.form,
            "terms": correction.terms,
            "held_out_gain": correction.gain.percent,
            "gain_sigma": correction.gain.sigma,
            "gain_significance": correction.gain.significance,
        }
        for correction in left.corrections
    ]
    return {
        "part": left.part,
        "bound_to": left.bound_to,
        "rms_over_noise": left.rms_over_noise,
        "corrections": corrections,
    }


def _noise(floor: NoiseFloor) -> dict[str, Any]:
    return {
        "part": floor.part,
        "stated_px": floor.stated_px,
        "within_px": floor.within_px,
        "repeats_px": floor.repeats_px,
        "measured_px": floor.measured_px,
        "error_px": floor.error_px,
        "used_px": floor.used_px,
        "believable": floor.believable,
    }


def _gains(gains: Gains) -> dict[str, Any]:
    return {
        "display_refitted": _refitted(gains.display),
        "seethrough_refitted": _refitted(gains.see_through),
        "rendered_with_refitted_models": _rendered(gains.calibrated),
        "rendered_with_prescription": _rendered(gains.prescribed),
        "lacking": list(gains.lacking),
    }


def _refitted(refitted: Refitted | None) -> dict[str, float] | None:
    if refitted is None:
        return None
    return {
        "degree": refitted.degree,
        "before_rms_arcmin": refitted.before,
        "after_rms_arcmin": refitted.after,
        "held_out_gain": refitted.gain.percent,
        "gain_sigma": refitted.gain.sigma,
        "gain_significance": refitted.gain.significance,
    }


def _rendered(rendered: Rendered | None) -> dict[str, float] | None:
    if rendered is None:
        return None
    return {
        "before_rms_arcmin": rendered.before.rms,
        "before_p95_arcmin": rendered.before.p95,
        "after_rms_arcmin": rendered.after.rms,
        "after_p95_arcmin": rendered.after.p95,
        "points": rendered.after.count,
    }


def _finite(value: Any) -> Any:
    """The same with numbers that JSON knows."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, bool) or not isinstance(value, float | int):
        return value.item() if hasattr(value, "item") else value
    return value if math.isfinite(value) else None
