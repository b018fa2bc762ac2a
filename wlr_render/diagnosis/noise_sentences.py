"""Repeatability and noise of a bench in sentences."""

from dataclasses import replace
from math import exp, expm1, floor, hypot, isfinite, log10

from wlr_render.diagnosis.diagnosis import LOCATED, PARTLY, UNEXPLAINED, Diagnosis, MotionSize
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import PART_NAMES
from wlr_render.report.blocks import cell_text

_UNSURE = 0.5  # relative error from which only an upper limit of a size is stated
_AGREE = 2.0  # standard errors within which two parts have the same repeatability and noise
_ABOUT_HALF = 0.05
_AS_STATED = 0.02  # relative difference of the noise that is not worth a word


def bench_sentence(diagnosis: Diagnosis) -> str:
    """Repeatability and noise of the bench: one sentence if the parts of the session agree, else one for each part."""
    both = both_parts(diagnosis)
    if both is not None:
        return f"{_capital(_figures(*both))}."
    motions, unknown = {motion.part: motion for motion in diagnosis.motions}, undetermined_parts(diagnosis)
    return " ".join(
        f"{_capital(floor.part)}: {_figures(floor, None if floor.part in unknown else motions.get(floor.part))}."
        + (f" {_capital(_undetermined(floor.part))}." if floor.part in unknown and floor.part in motions else "")
        for floor in diagnosis.noise_floors
    )


def both_parts(diagnosis: Diagnosis) -> tuple[NoiseFloor, MotionSize] | None:
    """Noise and repeatability of both parts of a session, the means weighted by their errors; None if the parts differ.

    Also None for a session of one part, and where the repeatability of a part is not determined.
    """
    motions = {motion.part: motion for motion in diagnosis.motions}
    if len(diagnosis.noise_floors) != 2 or len(motions) != 2 or undetermined_parts(diagnosis):
        return None
    first, second = diagnosis.noise_floors
    noise, motion = _mean_noise(first, second), _mean_motion(motions[first.part], motions[second.part])
    return (noise, motion) if noise is not None and motion is not None else None


def undetermined_parts(diagnosis: Diagnosis) -> set[str]:
    """Parts with a residual by no cause that noise and repeatability of a usual size do not cover.

    The fit of the causes takes that residual for motions of the captures, so their size is no repeatability.
    """
    if diagnosis.verdict not in (LOCATED, PARTLY, UNEXPLAINED):
        return set()
    scatter = diagnosis.fit.scatter
    return {
        floor.part
        for floor in diagnosis.noise_floors
        if not scatter.is_ordinary(PART_NAMES.index(floor.part), diagnosis.settings.material_excess)
    }


def _undetermined(part: str) -> str:
    return f"repeatability of the {part} is not determined, as no cause explains its residual"


def _figures(noise: NoiseFloor, motion: MotionSize | None) -> str:
    """Repeatability, noise and shape of the noise."""
    return ", ".join([*([_repeatability(motion)] if motion else []), _level(noise), *_shape(noise)])


def _repeatability(motion: MotionSize) -> str:
    shift = _size(motion.shift_um, motion.shift_error_um, "um")
    return f"positions repeat to {shift}, turns to {_size(motion.turn_urad, motion.turn_error_urad, 'urad')}"


def _size(value: float, error: float, unit: str) -> str:
    """A size with its error, or its upper limit where the session shows no such size."""
    if error > _UNSURE * value:
        return f"better than {cell_text(float(f'{value * exp(2.0 * error / value):.2g}'))} {unit}"
    return f"{with_error(value, error)} {unit}"


def with_error(value: float, error: float) -> str:
    """A value to one digit of its standard error, and the error; a dash where the value is not known."""
    if not (isfinite(value) and error > 0.0):
        return cell_text(value)
    decimals = max(0, -floor(log10(float(f"{error:.0e}"))))
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"


def _level(noise: NoiseFloor) -> str:
    stated, measured = f"{noise.stated_px:#.3g}", f"{noise.measured_px:#.3g}"
    if not isfinite(noise.measured_px):
        return f"noise {stated} camera px as stated (too few points to measure it)"
    is_as_stated = abs(noise.measured_px / noise.stated_px - 1.0) < _AS_STATED
    if is_as_stated:
        return f"noise {stated} camera px as stated"
    return f"noise {measured} camera px where {stated} is stated"


def _shape(noise: NoiseFloor) -> list[str]:
    """How the noise differs between places and photographs, and what neighbours share."""
    texts = []
    if noise.rim_factor > 1.0:
        texts.append(f"rising to {noise.rim_factor:.2g} times in the corner of the image")
    if noise.rim_factor < 1.0:
        texts.append(f"falling to {noise.rim_factor:.2g} times in the corner of the image")
    if noise.photographs_differ > 0.0:
        texts.append(f"photographs differ in noise by {100 * expm1(noise.photographs_differ):.0f} %")
    if noise.shared > 0.0:
        share = "half" if abs(noise.shared - 0.5) < _ABOUT_HALF else f"{100 * noise.shared:.0f} %"
        reach = f"(within {noise.shared_reach_px:.0f} camera px)"
        texts.append(f"{share} of the noise variance is shared by neighbouring points {reach}")
    return texts


def _mean_motion(first: MotionSize, second: MotionSize) -> MotionSize | None:
    """The mean of the motions of two parts, weighted by their errors; None where they differ by more than these."""
    shift = _mean((first.shift_um, first.shift_error_um), (second.shift_um, second.shift_error_um))
    turn = _mean((first.turn_urad, first.turn_error_urad), (second.turn_urad, second.turn_error_urad))
    return MotionSize(f"{first.part} and {second.part}", *shift, *turn) if shift and turn else None


def _mean_noise(first: NoiseFloor, second: NoiseFloor) -> NoiseFloor | None:
    """The noise of two parts that have the same; None where they differ."""
    level = _mean((first.measured_px, first.error_px), (second.measured_px, second.error_px))
    if level is None or _shape(first) != _shape(second) or f"{first.stated_px:.3g}" != f"{second.stated_px:.3g}":
        return None
    return replace(first, part=f"{first.part} and {second.part}", measured_px=level[0], error_px=level[1])


def _mean(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float] | None:
    """The mean of two (size, standard error) weighted by the errors; None where they differ, or are not known."""
    (a, error_a), (b, error_b) = first, second
    error = hypot(error_a, error_b)
    if not abs(a - b) <= _AGREE * error or max(error_a / a, error_b / b) > _UNSURE:
        return None
    return (a * error_b**2 + b * error_a**2) / error**2, error_a * error_b / error


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
