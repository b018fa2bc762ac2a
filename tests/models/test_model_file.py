import dataclasses
import json

import numpy as np
import pytest
from toy_models import DISPLAYS, EYE_BOX, SEE_THROUGHS, bundle_display, bundle_see_through

from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeMappings
from wlr_render.models.model_file import EyeModel, load_eye_model, save_eye_model
from wlr_render.numerics.polynomial import Polynomial


def model(display=None, see_through=None):
    display, see_through = display or bundle_display(), see_through or bundle_see_through()
    mappings = EyeMappings("toy (planar N=2)", "left", display, see_through, EYE_BOX)
    return EyeModel(mappings, "toy", {"display": {"rms_arcmin": 0.1 + 0.2}})


def assert_same(first, second):
    """Bitwise, through all fields."""
    assert type(first) is type(second)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if dataclasses.is_dataclass(a):
            assert_same(a, b)
        elif isinstance(a, np.ndarray):
            assert a.tobytes() == b.tobytes()
        else:
            assert a == b


@pytest.mark.parametrize("display", DISPLAYS)
@pytest.mark.parametrize("see_through", SEE_THROUGHS)
def test_every_kind_comes_back_bit_for_bit(tmp_path, display, see_through):
    written = model(DISPLAYS[display](), SEE_THROUGHS[see_through]())
    read = load_eye_model(save_eye_model(tmp_path / "eye.json", written))
    assert_same(written, read)


def test_terms_written_are_the_polynomial(tmp_path):
    """A reader with nothing but the file's own description gets the same value."""
    record = json.loads(save_eye_model(tmp_path / "eye.json", model()).read_text())["display"]["forward"]
    inputs = np.array([120.0, 640.0, 0.031, -0.002])
    low, high = np.array(record["low"]), np.array(record["high"])
    scaled = (2 * inputs - low - high) / (high - low)
    value = sum(
        np.array(term["values"]) * np.prod(np.cos(np.array(term["orders"]) * np.arccos(scaled)))
        for term in record["terms"]
    )
    np.testing.assert_allclose(value, bundle_display().forward(inputs), rtol=1e-12)


def edited(tmp_path, edit):
    path = save_eye_model(tmp_path / "eye.json", model())
    record = json.loads(path.read_text())
    edit(record)
    path.write_text(json.dumps(record))
    return path


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda r: r.update(format="other"), "not a model file: its format is not 'wlr-eye-model'"),
        (lambda r: r.pop("format"), "not a model file"),
        (lambda r: r.update(version=2), "has version 2; this program reads version 1"),
        (lambda r: r.update(frame="opencv"), "'frame' is 'opencv'; it must be one of openxr"),
        (lambda r: r["display"].pop("base_plane"), r"\[display\]: key 'base_plane' is missing"),
        (lambda r: r.pop("eye_box"), "key 'eye_box' is missing"),
        (lambda r: r["display"].update(kind="magic"), "'kind' is 'magic'; it must be one of planar"),
        (lambda r: r["display"]["forward"].update(degree=3), "degree 3 in 4 variables has 35 terms, but .* has 15"),
        (lambda r: r["display"]["forward"]["terms"].reverse(), "must be all those of total degree up to 2"),
        (lambda r: r["display"]["forward"]["terms"][0].update(values=[1.0]), "'values' must be a list of 2 numbers"),
        (lambda r: r["display"]["forward"]["terms"][0].update(values=[1.0, np.nan]), "'values' must be finite"),
        (lambda r: r["display"]["forward"].update(low=r["display"]["forward"]["high"]), "'low' must be less than"),
        (lambda r: r["display"]["panel"].update(width_px=10.5), "'width_px' must be a whole number"),
        (lambda r: r.update(colour="red"), "unknown key 'colour'"),
        (lambda r: r.update(report=[1]), "'report' must be an object"),
    ],
)
def test_a_fault_in_a_file_is_one_sentence_with_its_name(tmp_path, edit, sentence):
    path = edited(tmp_path, edit)
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_eye_model(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(None, "cut short"), (b"", "cut short"), (b"\x93NUMPY\xff", "is not a model file"), (b"[1, 2]", "not an object")],
)
def test_files_that_are_cut_short_or_something_else(tmp_path, content, sentence):
    path = save_eye_model(tmp_path / "eye.json", model())
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    with pytest.raises(BadInputError, match=sentence):
        load_eye_model(path)


def test_missing_files_and_foreign_mappings_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="cannot be read"):
        load_eye_model(tmp_path / "none.json")
    foreign = dataclasses.replace(model().mappings, display=Polynomial)
    with pytest.raises(BadInputError, match="cannot be written to a model file"):
        save_eye_model(tmp_path / "eye.json", dataclasses.replace(model(), mappings=foreign))
    assert list(tmp_path.iterdir()) == []
