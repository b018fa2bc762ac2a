"""Sets whose light drifts and flickers, with white photographed again every few pictures."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.code_files import CodeFiles, find_code_files
from wlr_render.captures.decoded import Decoded, DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.patterns.show_page import write_show_page
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import read_photograph, write_photograph
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

KIND = PhotographFormat(8)
PANEL = Panel(240, 190)
PICTURE_S, EXPOSURE_S = 1.7, 0.004  # of a camera that does not know the mains


def light(count: int, size: float = 1.0) -> NDArray[np.float64]:
    """Light (count,) of a lamp that warms up, dims and recovers, and that the mains make flicker at 100 Hz."""
    time = PICTURE_S * (np.arange(count) + 0.003 * np.random.default_rng(6).standard_normal(count))
    drift = -0.35 * np.exp(-(((time / time[-1] - 0.6) / 0.2) ** 2)) + 0.1 * np.tanh(time / 8.0)
    turn, over = 2 * np.pi * 100.0 * time, 2 * np.pi * 100.0 * EXPOSURE_S
    flicker = 0.25 * (np.cos(turn) - np.cos(turn + over)) / over  # mean of a sine over the exposure
    return np.asarray((1.0 + size * drift) * (1.0 + size * flicker))


def photographed(
    folder: Path, camera: Any, pattern: Pattern, white_every: int | None = 6, size: float = 1.0
) -> list[Path]:
    """Photograph the pictures of the page, in their order, in light that changes."""
    shown = [path.name for path in write_show_page(folder / "page", pattern, white_every=white_every)]
    names = [name.replace(" ", "_") for name in pattern.names()]
    still = dict(zip(names, camera.photographs(pattern), strict=True))
    paths = []
    for name, gain in zip(shown, light(len(shown), size), strict=True):
        grey = camera.black + gain * (still[Path(name).stem[4:]] - camera.black)
        paths.append(folder / "set" / name)
        paths[-1].parent.mkdir(exist_ok=True)
        write_photograph(paths[-1], np.clip(np.round(grey), 0, 255).astype(np.uint8))
    return paths


def changed(paths: list[Path], change: Callable[[NDArray[np.float64], int], NDArray[np.float64]]) -> None:
    """Change photographs after the fact; `change` gets the grey values and the place in the order of taking."""
    for number, path in enumerate(paths):
        grey = change(read_photograph(path, KIND).astype(np.float64), number)
        write_photograph(path, np.clip(np.round(grey), 0, 255).astype(np.uint8))


def decoded(files: CodeFiles, pattern: Pattern) -> Decoded:
    return pattern.decode(files.read(KIND), DecodeOptions(KIND.full_scale, end_of_scale=files.end_of_scale(KIND)))


def rms(camera: Any, found: Decoded) -> float:
    assert np.mean(found.accepted[camera.whole()]) > 0.9
    off = (found.pixel - camera.truth())[found.accepted & camera.whole()]
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.parametrize("code", ["gray", "fringes", "gray-fringes"])
def test_positions_are_as_of_steady_light(code: str, tmp_path: Path, toy_camera: Callable[..., Any]) -> None:
    pattern, camera = make_pattern(code, PANEL), toy_camera(PANEL, white=150.0)
    photographed(tmp_path, camera, pattern)
    files = find_code_files(tmp_path / "set", pattern.names())
    found, still = decoded(files, pattern), pattern.decode(camera.photographs(pattern))
    assert rms(camera, found) < 1.1 * rms(camera, still)
    gains = files.light(KIND)
    assert gains is not None
    assert "White photographs taken again differ by" in gains.note
    assert gains.unpaired == 0
    with pytest.raises(BadInputError, match="the light has changed"):
        decoded(replace(files, whites=()), pattern)


def test_flicker_that_is_not_refused_is_repaired_too(tmp_path: Path, toy_camera: Callable[..., Any]) -> None:
    pattern, camera = make_pattern("fringes", PANEL), toy_camera(PANEL, white=150.0)
    photographed(tmp_path, camera, pattern, size=0.3)
    files = find_code_files(tmp_path / "set", pattern.names())
    repaired, raw = decoded(files, pattern), decoded(replace(files, whites=()), pattern)
    assert rms(camera, repaired) < 0.5 * rms(camera, raw)


def test_a_camera_with_a_gamma_does_not_mislead_the_repair(tmp_path: Path, toy_camera: Callable[..., Any]) -> None:
    pattern, camera = make_pattern("gray-fringes", PANEL), toy_camera(PANEL, white=150.0, black=0.0, camera_gamma=2.2)
    photographed(tmp_path, camera, pattern)
    found = decoded(find_code_files(tmp_path / "set", pattern.names()), pattern)
    assert rms(camera, found) < 1.3 * rms(camera, pattern.decode(camera.photographs(pattern))) + 0.01


def test_steps_without_an_inverse_follow_the_drift_and_the_note_says_so(
    tmp_path: Path, toy_camera: Callable[..., Any]
) -> None:
    pattern, camera = make_pattern("fringes", PANEL, steps=5), toy_camera(PANEL, white=150.0)
    paths = photographed(tmp_path, camera, pattern, white_every=3)
    files = find_code_files(tmp_path / "set", pattern.names())
    gains = files.light(KIND)
    assert gains is not None
    assert gains.unpaired == len(pattern.names()) - 2
    assert f"the flicker of {gains.unpaired} pictures without an inverse stays" in gains.note
    assert np.isnan(gains.flicker)
    drift = light(len(paths))[np.array(files.taken)] / light(len(paths))[0]
    assert np.corrcoef(gains.gain[2:], drift[2:])[0, 1] > 0.3


def test_a_manifest_names_the_whites_in_the_order_of_taking(tmp_path: Path, toy_camera: Callable[..., Any]) -> None:
    pattern, camera = make_pattern("gray", PANEL), toy_camera(PANEL, white=150.0)
    paths = photographed(tmp_path, camera, pattern)
    roles = [path.stem[4:].replace("_", " ") for path in paths]
    for number, path in enumerate(paths):
        path.rename(path.with_name(f"{chr(122 - number % 26)}{number}.png"))
    rows = [f'"{chr(122 - number % 26)}{number}.png" = "{role}"' for number, role in enumerate(roles)]
    (tmp_path / "set" / "manifest.toml").write_text("\n".join(["[files]", *rows]))
    files = find_code_files(tmp_path / "set", pattern.names())
    assert [place for place, _ in files.whites] == [number for number, role in enumerate(roles) if role == "white"][1:]
    assert rms(camera, decoded(files, pattern)) < 0.03


def test_whites_that_cannot_be_compared_are_refused(tmp_path: Path, toy_camera: Callable[..., Any]) -> None:
    pattern, camera = make_pattern("gray", PANEL), toy_camera(PANEL, white=150.0)
    paths = photographed(tmp_path, camera, pattern)
    again = [path for path in paths if path.stem.endswith("_white")][1]
    write_photograph(again, np.zeros((128, 160), np.uint8))
    with pytest.raises(BadInputError, match="a white photograph taken again is no brighter than black; take it again"):
        decoded(find_code_files(tmp_path / "set", pattern.names()), pattern)
    paths[1].unlink()
    with pytest.raises(BadInputError, match="need the first white and black"):
        decoded(find_code_files(tmp_path / "set", pattern.names()), pattern)


def lamp(grey: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    """A lamp of the room that flickers, on the left more than on the right."""
    size = 30.0 * np.random.default_rng(number).uniform()
    return grey + size * np.linspace(1.0, 0.3, grey.shape[1])


def lamp_off_once(grey: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    return grey + 20.0 * (number != 10)


def bands(grey: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    """Bands of a rolling shutter that drift from photograph to photograph."""
    turn = np.linspace(0.0, 1.4, grey.shape[0])[:, None] + np.random.default_rng(number).uniform()
    return 10.0 + (grey - 10.0) * (1.0 + 0.15 * np.sin(2 * np.pi * turn))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lamp, "of white (brighter|darker) than 'black' where the panel lights nothing: other light has changed"),
        (lamp_off_once, "photograph 'u fringe .*' is 1[3-5]% of white darker than 'black' where the panel lights"),
        (bands, "differs from the first by a light that changes by .*% rms across the picture, as bands of a rolling"),
    ],
)
def test_light_that_gains_do_not_describe_is_refused(
    change: Callable[[NDArray[np.float64], int], NDArray[np.float64]],
    sentence: str,
    tmp_path: Path,
    toy_camera: Callable[..., Any],
) -> None:
    pattern, camera = make_pattern("fringes", PANEL), toy_camera(PANEL, white=150.0)
    changed(photographed(tmp_path, camera, pattern, size=0.0), change)
    with pytest.raises(BadInputError, match=sentence):
        decoded(find_code_files(tmp_path / "set", pattern.names()), pattern)
