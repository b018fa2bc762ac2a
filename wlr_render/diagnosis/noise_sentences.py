"""Repeatability and noise of a bench in sentences."""

from math import exp, expm1, isfinite

from wlr_render.diagnosis.diagnosis import LOCATED, PARTLY, UNEXPLAINED, Diagnosis, MotionSize
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import PART_NAMES
from wlr_render.numerics.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN
from wlr_render.report.blocks import capitalised, cell_text, quantity

_UNSURE = 0.5  # relative error of a size from which only its upper limit is stated
_ABOUT_HALF = 0.05  # difference of a share from one half that is not worth a number
_AS_STATED = 0.02  # relative difference of the noise that is not worth a word


def bench_sentence(diagnosis: Diagnosis) -> str:
    """Return the repeatability and the noise of the bench: one sentence for each part of the session."""
    motions, unknown = {motion.part: motion for motion in diagnosis.motions}, undetermined_parts(diagnosis)
    sentences = []
    for floor in diagnosis.noise_floors:
        motion = motions.get(floor.part)
        is_unknown = floor.part in unknown
        figures = [_repeatability(motion)] if motion and not is_unknown else []
        sentences.append(f"{capitalised(floor.part)}: {', '.join([*figures, _level(floor), *_shape(floor)])}.")
        if motion and is_unknown:
            sentences.append(f"Repeatability of the {floor.part} is not determined, as no cause explains its residual.")
    return " ".join(sentences)


def undetermined_parts(diagnosis: Diagnosis) -> set[str]:
    """Return the parts with a residual by no cause that noise and repeatability of a usual size do not cover.

    The fit of the causes takes that residual for motions of the captures, so their size must not be read as
    repeatability.
    """
    if diagnosis.verdict not in (LOCATED, PARTLY, UNEXPLAINED):
        return set()
    scatter = diagnosis.fit.scatter
    return {
        floor.part
        for floor in diagnosis.noise_floors
        if not scatter.is_ordinary(PART_NAMES.index(floor.part), diagnosis.settings.material_excess)
    }


def _repeatability(motion: MotionSize) -> str:
    shift = _size(motion.shift_um, motion.shift_error_um, "um", UNUSUAL_SHIFT)
    turn = _size(motion.turn_urad, motion.turn_error_urad, "urad", UNUSUAL_TURN)
    return (
        f"{f'positions repeat to {shift}' if shift else 'repeatability of positions unknown'}, "
        f"{f'turns to {turn}' if turn else 'repeatability of turns unknown'}"
    )


def _size(value: float, error: float, unit: str, unusual: float) -> str:
    """Return a size with its error, or its upper limit where the session shows no such size; empty if unknown."""
    if error <= _UNSURE * value:
        return f"{quantity(value, error)} {unit}"
    # A size that no reading depends on has an error of many powers of ten.
    limit = value * exp(min(2.0 * error / value, 100.0))
    return "" if limit > unusual else f"better than {cell_text(float(f'{limit:.2g}'))} {unit}"


def _level(noise: NoiseFloor) -> str:
    stated, measured = f"{noise.stated_px:#.3g}", f"{noise.measured_px:#.3g}"
    if not isfinite(noise.measured_px):
        return f"noise {stated} camera px as stated (too few points to measure it)"
    if abs(noise.measured_px / noise.stated_px - 1.0) < _AS_STATED:
        return f"noise {stated} camera px as stated"
    return f"noise {measured} camera px where {stated} is stated"


def _shape(noise: NoiseFloor) -> list[str]:
    """Return how the noise differs between places and photographs, and how much of it neighbours share."""
    texts = []
    if noise.rim_factor != 1.0:
        trend = "rising" if noise.rim_factor > 1.0 else "falling"
        texts.append(f"{trend} to {noise.rim_factor:.2g} times in the corner of the image")
    if noise.photographs_differ > 0.0:
        texts.append(f"photographs differ in noise by {100 * expm1(noise.photographs_differ):.0f} %")
    if noise.shared > 0.0:
        share = "half" if abs(noise.shared - 0.5) < _ABOUT_HALF else f"{100 * noise.shared:.0f} %"
        reach = f"(within {noise.shared_reach_px:.0f} camera px)"
        texts.append(f"{share} of the noise variance is shared by neighbouring points {reach}")
    return texts
