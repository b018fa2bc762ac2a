"""How a bench's repeatability and noise are put into words."""

from types import SimpleNamespace
from typing import Any, cast

from wlr_render.diagnosis.diagnosis import DiagnosisRecord, MotionSize
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.verdict_sentences import bench_sentence

NAN = float("nan")


def floor(part: str, measured: float = 0.108, error: float = 0.001, **shape: Any) -> NoiseFloor:
    return NoiseFloor(part, 0.1, measured, NAN, measured, error, measured, measured < 0.105, **shape)


def sentence(floors: tuple[Any, ...], motions: tuple[MotionSize, ...] = ()) -> str:
    record = SimpleNamespace(noise_floors=floors, motions=motions, unexplained_parts=())
    return bench_sentence(cast(DiagnosisRecord, record))  # it takes nothing else from a record


def test_each_part_has_a_sentence_with_its_repeatability_and_the_shape_of_its_noise() -> None:
    rising = {"rim_factor": 1.9, "photographs_differ": 0.405, "shared": 0.52, "shared_reach_px": 61.0}
    floors = (floor("display", 0.1013, **rising), floor("see-through", rim_factor=0.7, shared=0.3, shared_reach_px=9.0))
    motions = (MotionSize("display", 9.0, 0.97, 25.0, 3.0), MotionSize("see-through", 15.2, 2.0, 23.0, 4.0))
    assert sentence(floors, motions) == (
        "Display: positions repeat to 9 +- 1 um, turns to 25 +- 3 urad, noise 0.100 camera px as stated, rising to 1.9 "
        "times in the corner of the image, photographs differ in noise by 50 %, half of the noise variance is shared "
        "by neighbouring points (within 61 camera px). "
        "See-through: positions repeat to 15 +- 2 um, turns to 23 +- 4 urad, noise 0.108 camera px where 0.100 is "
        "stated, falling to 0.7 times in the corner of the image, 30 % of the noise variance is shared by neighbouring "
        "points (within 9 camera px)."
    )


def test_sizes_that_are_not_known_are_not_stated() -> None:
    """A size within its own error has an upper limit: twice its relative error above it, as logarithms."""
    text = sentence((floor("display", NAN, NAN),), (MotionSize("display", 1.0, 0.9, 25.0, 3.0),))
    assert "positions repeat to better than 6 um" in text
    unseen = sentence((floor("display", NAN, NAN),), (MotionSize("display", 13.0, 598.0, 25.0, 3.0),))
    assert "repeatability of positions unknown, turns to 25 +- 3 urad" in unseen
    assert "noise 0.100 camera px as stated (too few points to measure it)" in text
    assert sentence((floor("run-time"),)) == "Run-time: noise 0.108 camera px where 0.100 is stated."
