"""Random damage to a valid file gives a sentence or a correct result, whatever the reader."""

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from corpus.base_files import make_bases
from corpus.case import Case
from corpus.running import made_once
from wlr_render.bench.session_folder import load_session
from wlr_render.calibration.bench.station_file import load_station
from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.camera_lens_file import load_lens
from wlr_render.captures.capture_file import load_observations
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError
from wlr_render.models.model_file import load_eye_models
from wlr_render.optics.device_file import device_of, load_device
from wlr_render.optics.device_writer import device_content
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.headset_of_lens import HeadsetChoices, headset_of_lens
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.rendering.scene_file import load_scene
from wlr_render.toml_files import Table
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory

EXAMPLES = int(os.environ.get("WLR_DAMAGE_EXAMPLES", "25"))
"""Random damages of each file: few in every run of the tests, more when a reader has changed."""


def _read_recording(path: Path) -> object:
    return read_head_trajectory(path), read_eye_trajectory(path)


def _read_optics(path: Path) -> object:
    _, lens = read_lens_file(path, GlassCatalogue((path.with_name("glasses.agf"),)))
    device = headset_of_lens(path, lens, CHOICES).device
    return device_of(Table(device_content(device), str(path)))


# The file and the reader of each, by the name of what it damages. A reader of a folder gets the folder.
READERS: dict[str, Callable[[Path], object]] = {
    "device.toml": load_device,
    "prism5701202.toml": load_device,
    "birdbath28.toml": load_device,
    "freeform40.toml": load_device,
    "scene.toml": load_scene,
    "box.obj": load_scene,
    "box.ply": load_scene,
    "binary.ply": load_scene,
    "textured.glb": load_scene,
    "gltf/box.gltf": load_scene,
    "model.json": load_eye_models,
    "captures.npz": load_observations,
    "head.txt": read_head_trajectory,
    "head.csv": read_head_trajectory,
    "eyes.txt": read_eye_trajectory,
    "gaze.txt": read_eye_trajectory,
    "recording.jsonl": _read_recording,
    "bench/bench.toml": lambda path: load_session(path.parent),
    "bench/display.csv.gz": lambda path: load_session(path.parent),
    "photos/session.toml": lambda path: load_photo_session(path.parent),
    "board.toml": load_board,
    "calibration/station-right.json": load_station,
    "lens.yaml": load_lens,
    "lens_ros.yaml": load_lens,
    "camchain.yaml": load_lens,
    "target.yaml": load_board,
    "lens.xml": load_lens,
    "lens.cameramodel": load_lens,
    "codes/03.png": read_photograph,
    "lens.zmx": _read_optics,
    "optiland.json": _read_optics,
    "rayoptics.roa": _read_optics,
    "glasses.agf": lambda path: _read_optics(path.with_name("lens.zmx")),
}
CHOICES = HeadsetChoices(
    name="lens",
    source="a lens file",
    starts_at="eye",
    pupil=None,
    eye_relief=None,
    panel=None,
    panel_size=(0.01, 0.008),
    pixels=(64, 48),
    eye_box_size=(0.008, 0.006, 0.004),
    eye_centre=(0.0, 0.0, 0.0),
    side="right",
    use_semi_diameters=True,
)
ENDLESS = ("aperture.low", "aperture.high", "mount.slip_time_s")
"""Results that are infinite where the file states none."""
WRONG = (b"nan", b"inf", b"-inf", b"1e308", b"-1", b"0", b"9" * 400, b'"text"', b"[]", b"{}", b"null", b"1e39", b"")
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")


@pytest.fixture(scope="session")
def bases(tmp_path_factory, worker_id):
    root = tmp_path_factory.getbasetemp()
    return made_once((root if worker_id == "master" else root.parent) / "corpus", make_bases)


@st.composite
def damages(draw):
    """A function of a file's content that flips, cuts, doubles or replaces something at a random place."""
    kind = draw(st.sampled_from(["flip", "cut", "double", "drop", "number", "number", "number"]))
    place, length, wrong = draw(st.floats(0, 1)), draw(st.integers(1, 60)), draw(st.sampled_from(WRONG))
    bit = draw(st.integers(0, 7))

    def damage(content: bytes) -> bytes:
        at = int(place * (len(content) - 1))
        if kind == "flip":
            return content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
        if kind == "cut":
            return content[:at]
        if kind == "double":
            return content[: at + length] + content[at:]
        found = NUMBER.search(content, at) or NUMBER.search(content)
        if kind == "drop" or found is None:
            return content[:at] + content[at + length :]
        return content[: found.start()] + wrong + content[found.end() :]

    return damage


def infinite(value: Any, place: str = "result") -> Iterator[str]:
    """Places of a result that hold an infinite number; NaN stands for what is not recorded, and readers check it."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fc":
        yield from [place] if np.isinf(value).any() else []
    elif isinstance(value, float):
        yield from [place] if np.isinf(value) else []
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from infinite(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from infinite(part, f"{place}.{key}")


def wrongly_infinite(value: Any) -> list[str]:
    return [place for place in infinite(value) if not place.endswith(ENDLESS)]


@pytest.mark.parametrize("name", READERS)
def test_damage_ends_in_a_sentence_or_a_result(name, bases, tmp_path):
    # The lenses and boards of a session are beside it, a mesh finds its textures, and a lens its glasses.
    Case("", (), tuple(path.name for path in bases.iterdir() if path.name == name.split("/")[0])).build(bases, tmp_path)
    for neighbour in ("box.obj", "lens.zmx", "glasses.agf"):
        (tmp_path / neighbour).write_bytes((bases / neighbour).read_bytes())
    path = tmp_path / name
    valid = path.read_bytes()
    assert wrongly_infinite(READERS[name](path)) == []

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        derandomize="WLR_DAMAGE_EXAMPLES" not in os.environ,
        suppress_health_check=list(HealthCheck),
    )
    @given(damages())
    def check(damage):
        path.write_bytes(damage(valid))
        try:
            result = READERS[name](path)
        except BadInputError as error:
            sentence = str(error)
            assert "\n" not in sentence, sentence
            assert len(sentence) < 1000, sentence
            assert path.name in sentence or path.parent.name in sentence, sentence
        else:
            assert wrongly_infinite(result) == [], damage(valid)[:2000]

    check()
