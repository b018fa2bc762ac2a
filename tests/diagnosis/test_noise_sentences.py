"""How a bench's repeatability and noise are put into words."""

from types import SimpleNamespace

import pytest

from wlr_render.diagnosis.diagnosis import MotionSize
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.noise_sentences import bench_sentence, with_error

NAN = float("nan")


def floor(part, measured=0.108, error=0.001, **shape):
    return NoiseFloor(part, 0.1, measured, NAN, measured, error, measured, measured < 0.105, **shape)


def sentence(floors, motions):
    return bench_sentence(SimpleNamespace(noise_floors=floors, motions=motions, verdict="explained"))


def test_parts_that_agree_have_one_sentence():
    """The figures are the means weighted by their errors."""
    motions = (MotionSize("display", 9.0, 1.0, 25.0, 3.0), MotionSize("see-through", 11.0, 2.0, 23.0, 4.0))
    floors = (floor("display", 0.108, 0.001), floor("see-through", 0.109, 0.002))
    assert sentence(floors, motions) == (
        "Positions repeat to 9.4 +- 0.9 um, turns to 24 +- 2 urad, noise 0.108 camera px where 0.100 is stated."
    )


@pytest.mark.parametrize("differs", ["shift", "turn", "noise", "rim"])
def test_parts_that_differ_have_a_sentence_each(differs):
    motions = (
        MotionSize("display", 9.0, 1.0, 25.0, 3.0),
        MotionSize("see-through", 15.0 if differs == "shift" else 9.0, 1.0, 45.0 if differs == "turn" else 25.0, 3.0),
    )
    floors = (
        floor("display"),
        floor("see-through", 0.12 if differs == "noise" else 0.108, rim_factor=1.9 if differs == "rim" else 1.0),
    )
    text = sentence(floors, motions)
    assert text.startswith("Display: positions repeat to 9 +- 1 um, turns to 25 +- 3 urad, noise 0.108 camera px where")
    assert ". See-through: positions repeat to " in text


def test_the_shape_of_the_noise_is_described():
    shape = {"rim_factor": 1.9, "photographs_differ": 0.405, "shared": 0.52, "shared_reach_px": 61.0}
    text = sentence((floor("display", 0.1013, **shape),), (MotionSize("display", 9.0, 1.0, 25.0, 3.0),))
    assert text == (
        "Display: positions repeat to 9 +- 1 um, turns to 25 +- 3 urad, noise 0.100 camera px as stated, rising to 1.9 "
        "times in the corner of the image, photographs differ in noise by 50 %, half of the noise variance is shared "
        "by neighbouring points (within 61 camera px)."
    )


def test_what_is_not_known_is_not_stated():
    """A size within its own error has an upper limit: twice its relative error above it, as logarithms."""
    text = sentence((floor("display", NAN, NAN),), (MotionSize("display", 1.0, 0.9, 25.0, 3.0),))
    assert "positions repeat to better than 6 um" in text
    assert "noise 0.100 camera px as stated (too few points to measure it)" in text
    assert sentence((floor("run-time"),), ()) == "Run-time: noise 0.108 camera px where 0.100 is stated."


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(0.12152, 0.000803, "0.1215 +- 0.0008"), (11.7, 2.0, "12 +- 2"), (9.04, 0.97, "9 +- 1"), (0.108, NAN, "0.108")],
)
def test_a_value_is_rounded_by_its_error(value, error, text):
    assert with_error(value, error) == text
