"""Sets that cannot be right are refused with a sentence that names the photograph."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.decoded import DEFAULT_OPTIONS, Decoded, DecodeOptions, Rejection
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

PANEL = Panel(200, 170)
FAMILIES = pytest.mark.parametrize("name", PATTERNS)


@pytest.fixture(scope="module")
def sets(toy_camera: Callable[..., Any]) -> dict[Any, Any]:
    camera = toy_camera(PANEL, size_px=(150, 120), noise=4.0)
    patterns = {name: make_pattern(name, PANEL) for name in PATTERNS}
    return {name: (pattern, list(camera.photographs(pattern))) for name, pattern in patterns.items()}


def exchanged(photographs: Sequence[NDArray[np.uint8]], *places: tuple[int, int]) -> list[Any]:
    result = list(photographs)
    for one, other in places:
        result[one], result[other] = result[other], result[one]
    return result


def refusal(pattern: Pattern, photographs: Sequence[Any], options: DecodeOptions = DEFAULT_OPTIONS) -> str:
    with pytest.raises(BadInputError) as caught:
        pattern.decode(photographs, options)
    return str(caught.value)


@FAMILIES
def test_a_set_in_order_passes(sets: dict[Any, Any], name: str) -> None:
    pattern, shown = sets[name]
    assert pattern.decode(shown).accepted.mean() > 0.8


@FAMILIES
def test_one_too_few_and_one_too_many(sets: dict[Any, Any], name: str) -> None:
    pattern, shown = sets[name]
    last = len(shown) - 1
    assert f"photograph {last} ('{pattern.names()[last]}') is missing" in refusal(pattern, shown[:-1])
    assert "more photographs" in refusal(pattern, shown + shown[-1:])
    assert "photograph 0 ('white') is missing" in refusal(pattern, [])


def test_another_size_or_depth(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    small = [*shown[:5], shown[5][:-1], *shown[6:]]
    assert refusal(pattern, small).startswith("photograph 5 ('u bit 6 inverse') is 150 x 119 pixels of 8 bits")
    deep = [*shown[:5], shown[5].astype(np.uint16), *shown[6:]]
    assert "16 bits" in refusal(pattern, deep)
    assert "photograph 0" in refusal(pattern, [np.zeros((4, 4, 3), dtype=np.uint8)])


def test_panel_off_or_exchanged_references(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    assert "was the panel on" in refusal(pattern, [shown[1]] * len(shown))
    assert "exchanged" in refusal(pattern, exchanged(shown, (0, 1)))


def test_an_over_exposed_set(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    blown = [np.clip(image.astype(int) * 4, 0, 255).astype(np.uint8) for image in shown]
    assert "photograph 0 ('white') is over-exposed" in refusal(pattern, blown)
    deep = [image.astype(np.uint16) * 256 for image in shown]
    assert "(255)" in refusal(pattern, deep)
    pattern.decode(deep, DecodeOptions(full_scale=65535))


def test_a_photograph_that_is_missing_in_the_middle_is_near_the_pair_that_is_named(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    sentence = refusal(pattern, [*shown[:7], *shown[8:]])
    assert sentence.startswith("photograph 6 ('u bit 5') and photograph 7 ('u bit 5 inverse') do not add up")


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
def test_a_bit_exchanged_with_its_inverse_is_named(sets: dict[Any, Any], name: str) -> None:
    pattern, shown = sets[name]
    # A picture that is exchanged in its coarsest bit would be a mirrored one, but for codes beyond the panel.
    for place in (place for place, label in enumerate(pattern.names()) if label.endswith("inverse")):
        sentence = refusal(pattern, exchanged(shown, (place - 1, place)))
        assert f"photograph {place - 1} " in sentence
        assert f"photograph {place} " in sentence
        assert "exchanged" in sentence


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
def test_two_bits_of_an_axis_exchanged_are_named(sets: dict[Any, Any], name: str) -> None:
    pattern, shown = sets[name]
    sentence = refusal(pattern, exchanged(shown, (2, 6), (3, 7)))
    assert "photograph 2 " in sentence
    assert "photograph 6 " in sentence


def test_bits_of_different_axes_exchanged_are_refused(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    of_v = pattern.names().index("v bit 5")
    refusal(pattern, exchanged(shown, (4, of_v), (5, of_v + 1)))


@pytest.mark.parametrize("name", ["fringes", "gray-fringes"])
@pytest.mark.parametrize("steps", [(0, 1), (2, 3), (1, 4), (0, 5), (1, 3)])
def test_exchanged_steps_are_named(sets: dict[Any, Any], name: str, steps: tuple[int, int]) -> None:
    pattern, shown = sets[name]
    first = len(shown) - 6
    one, other = first + steps[0], first + steps[1]
    sentence = refusal(pattern, exchanged(shown, (one, other)))
    assert f"photograph {one} ('{pattern.names()[one]}') and photograph {other} " in sentence
    assert "seem to be exchanged" in sentence


def test_exchanged_fringes_of_two_periods_are_refused(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["fringes"]
    sentence = refusal(pattern, exchanged(shown, *((8 + step, 14 + step) for step in range(6))))
    assert "contradict" in sentence


def test_fringes_of_another_axis_are_refused(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray-fringes"]
    of_u = pattern.names().index("u fringe 16 px step 0")
    sentence = refusal(pattern, exchanged(shown, *((of_u + step, len(shown) - 6 + step) for step in range(6))))
    assert f"photograph {of_u} " in sentence


def test_a_picture_of_something_else_among_the_steps(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["fringes"]
    shown = list(shown)
    shown[10] = np.full_like(shown[10], 20)
    assert refusal(pattern, shown).startswith("photograph 10 ('u fringe 59.33 px step 2') does not belong")


@FAMILIES
@pytest.mark.parametrize("reference", [0, 1])
@pytest.mark.parametrize("place", [2, 4, -1])
def test_a_reference_exchanged_with_a_picture_is_refused(
    sets: dict[Any, Any], name: str, reference: int, place: int
) -> None:
    pattern, shown = sets[name]
    assert "photograph 0 ('white')" in refusal(pattern, exchanged(shown, (reference, place)))


@FAMILIES
def test_any_photograph_missing_is_noticed_before_the_next_bit_or_fringe_is_over(
    sets: dict[Any, Any], name: str
) -> None:
    pattern, shown = sets[name]
    for missing in range(2, len(shown)):
        sentence = refusal(pattern, shown[:missing] + shown[missing + 1 :])
        named = max(int(number) for number in re.findall(r"photograph (\d+)", sentence))
        assert missing - 6 < named < missing + 14 or "is missing" in sentence


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
def test_one_missing_photograph_is_replaced_by_the_others(
    sets: dict[Any, Any],
    toy_camera: Callable[..., Any],
    errors_of: Callable[[Any, Decoded], tuple[Any, Any]],
    name: str,
) -> None:
    pattern, shown = sets[name]
    camera = toy_camera(PANEL, size_px=(150, 120), noise=4.0)
    whole = pattern.decode(shown)
    for missing in range(len(shown)):
        decoded = pattern.decode([*shown[:missing], None, *shown[missing + 1 :]])
        errors, share = errors_of(camera, decoded)
        assert share > 0.97 * errors_of(camera, whole)[1]
        assert np.mean(errors > 1) <= 1e-3
        inner = decoded.accepted & camera.whole()
        z = (decoded.pixel - camera.truth())[inner] / decoded.sigma_px[inner][:, None]
        assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3, pattern.names()[missing]


def test_a_missing_inverse_of_the_finest_bit_makes_positions_noisier(sets: dict[Any, Any]) -> None:
    """2 (positive - middle) has three times the variance of positive - inverse; half of it counts, on one axis."""
    pattern, shown = sets["gray"]
    place = pattern.names().index("u bit 0 inverse")
    whole, without = pattern.decode(shown), pattern.decode([*shown[:place], None, *shown[place + 1 :]])
    both = whole.accepted & without.accepted
    ratio = without.noise_px[both] ** 2 / whole.noise_px[both] ** 2
    assert np.median(ratio) == pytest.approx(1.5, abs=0.15)


def test_what_cannot_be_replaced_is_named(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray-fringes"]
    both = [*shown[:2], None, None, *shown[4:]]
    assert "'u bit 4') and photograph 3" in refusal(pattern, both)
    steps = [*shown[:-3], None, None, shown[-1]]
    assert "can do without one step only" in refusal(pattern, steps)
    assert "white') is missing" in refusal(pattern, [None, *shown[1:3], None, *shown[4:]])
    assert "'white') is missing" in refusal(sets["fringes"][0], [None, *sets["fringes"][1][1:]])


def test_a_gray_code_without_its_finest_bits_gives_coarse_positions(
    sets: dict[Any, Any], toy_camera: Callable[..., Any]
) -> None:
    pattern, shown = sets["gray"]
    camera = toy_camera(PANEL, size_px=(150, 120), noise=4.0)
    fine = [pattern.names().index(f"{axis} bit {bit}") for axis in "uv" for bit in (0, 1)]
    decoded = pattern.decode([None if {n, n - 1} & set(fine) else image for n, image in enumerate(shown)])
    inner = decoded.accepted & camera.whole()
    assert inner.sum() > 0.9 * camera.whole().sum()
    assert (decoded.cell_px[inner] == 4).all()
    z = (decoded.pixel - camera.truth())[inner] / decoded.sigma_px[inner][:, None]
    assert 0.1 < np.sqrt(np.mean(z**2)) < 1


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
@pytest.mark.parametrize("gain", [3.0, 8.0])
def test_an_over_exposed_panel_in_front_of_clipped_black_is_refused(
    toy_camera: Callable[..., Any], name: str, gain: float
) -> None:
    """Pictures of two values, 0 and 255, are not taken for pictures that no camera took."""
    pattern = make_pattern(name, PANEL)
    camera = toy_camera(PANEL, size_px=(150, 120), black=0.0, white=255.0 * gain, noise=0.1)
    assert "over-exposed" in refusal(pattern, camera.photographs(pattern))


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
def test_where_half_of_the_panel_is_over_exposed_the_other_half_is_read(
    toy_camera: Callable[..., Any], errors_of: Callable[[Any, Decoded], tuple[Any, Any]], name: str
) -> None:
    pattern = make_pattern(name, PANEL)
    white = np.linspace(150, 350, 150) * np.ones((120, 1))
    camera = toy_camera(PANEL, size_px=(150, 120), black=0.0, white=white, noise=1.0)
    decoded = pattern.decode(camera.photographs(pattern))
    assert np.mean(decoded.rejection[camera.whole() & (white > 262)] == Rejection.SATURATED) > 0.9
    errors, _ = errors_of(camera, decoded)
    assert errors.max() < 0.5


@pytest.mark.parametrize("told", ["gray", "fringes", "gray-fringes"])
@pytest.mark.parametrize("name", ["gray", "fringes", "gray-fringes"])
@pytest.mark.parametrize("look", [{}, {"noise": 4, "white": 60}, {"camera_gamma": 2.2}], ids=["clear", "dim", "gamma"])
def test_photographs_of_another_code_are_refused(
    toy_camera: Callable[..., Any], name: str, told: str, look: Mapping[str, float]
) -> None:
    panel = Panel(96, 64)
    camera = toy_camera(panel, size_px=(120, 90), scale=0.7, samples=3, **look)
    shown = list(camera.photographs(make_pattern(name, panel)))
    if name == told:
        assert make_pattern(told, panel).decode(shown).accepted.mean() > 0.5
    else:
        refusal(make_pattern(told, panel), shown)


def test_fringes_are_no_bits_and_their_inverses(toy_camera: Callable[..., Any]) -> None:
    panel = Panel(96, 64)
    camera = toy_camera(panel, size_px=(120, 90), scale=1.2, samples=3)
    shown = list(camera.photographs(make_pattern("gray-fringes", panel)))
    sentence = refusal(make_pattern("gray", panel), shown)
    assert "another code" in sentence or "choose the code that was shown" in sentence


def test_white_and_black_last_are_told_from_a_dark_panel(sets: dict[Any, Any]) -> None:
    _, shown = sets["gray"]
    sentence = refusal(sets["gray"][0], [*shown[2:], *shown[:2]])
    assert re.search(r"is brighter than .* in \d\d% of the picture and darker in \d\d%, .*--order opencv", sentence)


def test_hot_pixels_are_no_lit_panel(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    white = shown[1].copy()
    white[20, 30] = 250
    sentence = refusal(pattern, [white, *shown[1:]])
    assert "photograph 0 ('white') is nowhere brighter than photograph 1 ('black')" in sentence


def test_no_part_of_the_lit_pixels_is_above_all_of_them(sets: dict[Any, Any]) -> None:
    pattern, shown = sets["gray"]
    white = shown[1].copy()
    white[20:26, 30:36] = 250
    sentence = refusal(pattern, [white, *shown[1:]])
    assert re.search(r"in \d+ pixels, and the panel lights \d+: one of them shows something else", sentence)
