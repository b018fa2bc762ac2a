import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flat_image import FlatImage
from models.toy_models import (
    DISPLAYS,
    EYE_BOX,
    SEE_THROUGHS,
    Fitted,
    bundle_display,
    bundle_see_through,
    static_display,
)
from present import narrowed, present

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import Eye, Panel
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay, FittedModel
from wlr_render.models.model_file import EyeModel, add_eye_models, load_eye_model, load_eye_models, save_eye_models
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import IntArray
from wlr_render.numerics.polynomial import Polynomial, limited_orders


def model(display: FittedDisplay | None = None, see_through: SeeThroughModel | None = None) -> EyeModel:
    display, see_through = display or bundle_display(), see_through or bundle_see_through()
    mappings = Eye("toy (planar N=2)", "left", display, see_through, EYE_BOX)
    return EyeModel(mappings, "toy", {"display": {"rms_arcmin": 0.1 + 0.2}})


def assert_same(first: object, second: object) -> None:
    """Bitwise, through all fields."""
    assert type(first) is type(second)
    assert dataclasses.is_dataclass(first)
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
def test_every_kind_comes_back_bit_for_bit(tmp_path: Path, display: str, see_through: str) -> None:
    written = model(DISPLAYS[display](), SEE_THROUGHS[see_through]())
    read = load_eye_model(save_eye_models(tmp_path / "eye.json", [written]))
    assert_same(written, read)


def test_a_tilted_base_plane_comes_back(tmp_path: Path) -> None:
    tilted = dataclasses.replace(bundle_display(), place=BasePlane(0.02, (0.1, -0.2)))
    assert_same(load_eye_model(save_eye_models(tmp_path / "eye.json", [model(tilted)])), model(tilted))


def test_terms_written_are_the_polynomial(tmp_path: Path) -> None:
    """A reader with nothing but the file's own description gets the same value."""
    (eye,) = json.loads(save_eye_models(tmp_path / "eye.json", [model()]).read_text())["eyes"]
    record = eye["display"]["forward"]
    inputs = np.array([120.0, 640.0, 0.031, -0.002])
    low, high = np.array(record["low"]), np.array(record["high"])
    scaled = (2 * inputs - low - high) / (high - low)
    value = sum(
        np.array(term["values"]) * np.prod(np.cos(np.array(term["orders"]) * np.arccos(scaled)))
        for term in record["terms"]
    )
    np.testing.assert_allclose(value, bundle_display().forward(inputs), rtol=1e-12)


def edited(tmp_path: Path, edit: Callable[..., Any]) -> Path:
    path = save_eye_models(tmp_path / "eye.json", [model()])
    record = json.loads(path.read_text())
    edit(record)
    path.write_text(json.dumps(record))
    return path


def first(record: dict[str, Any]) -> dict[str, Any]:
    eye: dict[str, Any] = record["eyes"][0]
    return eye


def forward(record: dict[str, Any]) -> Any:
    return first(record)["display"]["forward"]


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda r: r.update(format="other"), "not a model file: its format is not 'wlr-eye-model'"),
        (lambda r: r.update(version=4), "has version 4; this program reads versions 1 to 3"),
        (lambda r: r.update(version=2), "has version 2, which no release wrote; calibrate again"),
        (lambda r: r.update(frame="opencv"), "'frame' is 'opencv'; it must be one of openxr"),
        (
            lambda r: first(r)["display"].pop("base_plane"),
            r"\[\[eyes\]\] number 1 \[display\]: key 'base_plane' is missing",
        ),
        (lambda r: first(r).pop("eye_box"), "key 'eye_box' is missing"),
        (lambda r: first(r)["display"].update(kind="magic"), "'kind' is 'magic'; it must be one of planar"),
        (lambda r: forward(r)["terms"][0].update(orders=[0, 0, 0.5, 0]), "'orders' must be whole numbers from 0 to 50"),
        (lambda r: forward(r)["terms"][0].update(orders=[0, -1, 0, 0]), "'orders' must be whole numbers from 0 to 50"),
        (lambda r: forward(r)["terms"].clear(), "'terms' is empty"),
        (lambda r: [t.update(values=[0.0, 0.0]) for t in forward(r)["terms"]], "'forward' shows all pixels in one"),
        (lambda r: forward(r).update(low=[0.0, 0.0, -1e17, 0.0]), r"'forward' has an input up to 1e\+17"),
        (
            lambda r: first(r)["display"]["panel"].update(width_px=32_000),
            r"'forward' is fitted to pixels .* a panel of 32000x",
        ),
        (lambda r: forward(r)["terms"][0].update(values=[1e17, 0.0]), r"'forward' reaches 1e\+17 within its own box"),
        (lambda r: forward(r).update(low=[0] * 4, high=[1, 1, 1, 0]), "'low' must be less than 'high'"),
        (lambda r: first(r)["display"]["panel"].update(width_px=10**9), r"has 1000000000x\d+ pixels, more than"),
        (
            lambda r: first(r)["display"]["base_plane"].update(z_m=1e9),
            r"'z_m' has the value 1e\+09; it must be -1 or more",
        ),
        (lambda r: first(r)["eye_box"].update(size_m=[0.01, -0.01, 0.01]), "'size_m' has a negative size"),
        (lambda r: first(r)["eye_box"].update(size_m=[10, 8, 6]), "is it in millimetres"),
        (lambda r: first(r)["eye_box"].update(centre_m=[32, 0, 0]), "is it in millimetres"),
        (lambda r: forward(r)["terms"].append(forward(r)["terms"][3]), "'terms' has the same 'orders' twice"),
        (
            lambda r: forward(r)["terms"][0].update(values=[1.0]),
            "'values' must be a list of 2 numbers",
        ),
        (lambda r: forward(r)["terms"][0].update(values=[1.0, np.nan]), "'values' must be finite"),
        (lambda r: forward(r)["terms"][0].update(values=[1.0, 1e308]), "'values' must be finite and below"),
        (lambda r: first(r)["display"]["panel"].update(width_px=10.5), "'width_px' must be a whole number"),
        (lambda r: first(r).update(colour="red"), r"\[\[eyes\]\] number 1: unknown key 'colour'"),
        (lambda r: first(r).update(report=[1]), "'report' must be an object"),
        (lambda r: r["eyes"].clear(), "'eyes' must hold one model, or one of each eye"),
        (lambda r: r["eyes"].append(first(r)), "'eyes' must hold one model, or one of each eye, not left, left"),
        (lambda r: r.update(eyes=3 * [first(r)]), "'eyes' has 3 entries; 2 is the most"),
    ],
)
def test_a_fault_in_a_file_is_one_sentence_with_its_name(
    tmp_path: Path, edit: Callable[..., Any], sentence: str
) -> None:
    path = edited(tmp_path, edit)
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_eye_model(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, r"cannot be read as a model file \(.*line"),
        (b"", "cannot be read as a model file"),
        (b"\x93NUMPY\xff", "this is not a model file"),
        (b"[1, 2]", "not an object"),
    ],
)
def test_truncated_and_other_files_are_refused(tmp_path: Path, content: bytes | None, sentence: str) -> None:
    path = save_eye_models(tmp_path / "eye.json", [model()])
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    with pytest.raises(BadInputError, match=sentence):
        load_eye_model(path)


def test_missing_files_and_foreign_mappings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="there is no such file; write it again"):
        load_eye_model(tmp_path / "none.json")
    foreign = dataclasses.replace(model().mappings, display=FlatImage(Panel(8, 5)))
    with pytest.raises(BadInputError, match="cannot be written to a model file"):
        save_eye_models(tmp_path / "eye.json", [dataclasses.replace(model(), mappings=foreign)])
    assert list(tmp_path.iterdir()) == []


def of_eye(eye: str, device: str = "toy") -> EyeModel:
    return dataclasses.replace(
        model(), mappings=dataclasses.replace(model().mappings, eye=eye, name=f"{device} {eye}"), device=device
    )


def test_both_eyes_of_a_headset_are_one_file(tmp_path: Path) -> None:
    left, right = of_eye("left"), of_eye("right")
    path = save_eye_models(tmp_path / "both.json", [right, left])
    read = load_eye_models(path)
    assert list(read) == ["left", "right"]
    assert_same(read["left"], left)
    assert_same(load_eye_model(path, "right"), right)
    with pytest.raises(BadInputError, match="holds models of both eyes; say which one is meant"):
        load_eye_model(path)


def test_an_eye_that_is_not_there_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = save_eye_models(tmp_path / "left.json", [of_eye("left")])
    assert load_eye_model(path, "left").mappings.eye == load_eye_model(path).mappings.eye == "left"
    with pytest.raises(BadInputError, match="is a model of the left eye; the right eye was asked for: calibrate it"):
        load_eye_model(path, "right")


def test_two_models_of_one_eye_or_of_two_devices_are_refused(tmp_path: Path) -> None:
    for models in ([of_eye("left")] * 2, [of_eye("left"), of_eye("right", "other")], []):
        with pytest.raises(BadInputError, match="holds one model of each eye of one device"):
            save_eye_models(tmp_path / "eye.json", models)
    assert list(tmp_path.iterdir()) == []


def test_an_eye_is_added_to_the_other_one_of_its_device_and_replaces_itself(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    assert add_eye_models(path, [of_eye("right")]) == ()
    assert add_eye_models(path, [of_eye("left")]) == ("right",)
    again = dataclasses.replace(of_eye("left"), report={"again": True})
    assert add_eye_models(path, [again]) == ("right",)
    read = load_eye_models(path)
    assert list(read) == ["left", "right"]
    assert_same(read["left"], again)
    # Models of another device do not stay beside it.
    assert add_eye_models(path, [of_eye("left", "other")]) == ()
    assert list(load_eye_models(path)) == ["left"]
    # The other eye's model may be saved from a file that is damaged.
    path.write_text("{")
    with pytest.raises(BadInputError, match="cannot be read as a model file"):
        add_eye_models(path, [of_eye("right")])
    assert path.read_text() == "{"


def test_any_table_of_terms_comes_back(tmp_path: Path) -> None:
    display, orders = bundle_display(), limited_orders(2, 3, 2, 1, 3)[::-1]
    coefficients = np.random.default_rng(0).normal(size=(len(orders), 2))
    forward = Polynomial(orders, display.forward.box, coefficients)
    written = model(dataclasses.replace(display, forward=forward))
    assert_same(load_eye_model(save_eye_models(tmp_path / "eye.json", [written])), written)


def as_version_1(record: dict[str, Any]) -> dict[str, Any]:
    """Base planes without a slope, polynomials with a total degree; a `backward` one answered backward queries."""
    display, see_through = first(record)["display"], first(record)["see_through"]
    for each in display, see_through:
        if "base_plane" in each:
            del each["base_plane"]["slope"]
    for part in (*display.values(), *see_through.values()):
        if isinstance(part, dict) and "terms" in part:
            part["degree"] = max(sum(term["orders"]) for term in part["terms"])
    display["backward"] = display.pop("backward_start")
    if "forward" in see_through:
        see_through["backward"] = see_through["forward"]
    return record


@pytest.mark.parametrize("kind", SEE_THROUGHS)
def test_files_of_version_1_are_still_read(tmp_path: Path, kind: str) -> None:
    """They hold one eye, whose keys stand beside those of the header."""
    written = model(DISPLAYS[kind](), SEE_THROUGHS[kind]())
    record = as_version_1(json.loads(save_eye_models(tmp_path / "eye.json", [written]).read_text()))
    (eye,) = record.pop("eyes")
    path = tmp_path / "old.json"
    path.write_text(json.dumps(record | eye | {"version": 1}))
    assert_same(load_eye_model(path), written)
    path.write_text(json.dumps(record | eye | {"version": 1, "colour": "red"}))
    with pytest.raises(BadInputError, match="unknown key 'colour'"):
        load_eye_models(path)


def with_spread(mapping: Fitted, sources: tuple[str, ...] = (), orders: IntArray | None = None) -> Fitted:
    """A mapping with factors of very different sizes; `apart` has two variables, `joint` three."""
    polynomial = mapping.modelled
    rng, outputs = np.random.default_rng(5), polynomial.coefficients.shape[1]
    orders = polynomial.orders if orders is None else orders

    def factors(count: int) -> Polynomial:
        size = 10.0 ** rng.uniform(-9.0, -3.0, count) * (1.0 if count else 0.0)
        return Polynomial(orders, polynomial.box, size * rng.normal(size=(len(orders), count)))

    spread = Covariance(outputs, factors(outputs // 2 * 2), factors(3 * outputs), sources)
    return mapping.with_spread(spread)


def of_both(
    display: Callable[[], FittedDisplay] = bundle_display,
    see_through: Callable[[], SeeThroughModel] = bundle_see_through,
    **spread: Any,
) -> EyeModel:
    return model(with_spread(display(), **spread), with_spread(see_through(), **spread))


def read_again(tmp_path: Path, written: EyeModel) -> EyeModel:
    return load_eye_model(save_eye_models(tmp_path / "eye.json", [written]))


@pytest.mark.parametrize("display", DISPLAYS)
@pytest.mark.parametrize("see_through", SEE_THROUGHS)
def test_a_spread_comes_back_to_five_digits_of_each_factor_and_then_bit_for_bit(
    tmp_path: Path, display: str, see_through: str
) -> None:
    written = of_both(DISPLAYS[display], SEE_THROUGHS[see_through], sources=("lens", "targets"))
    read = read_again(tmp_path, written)
    for side in ("display", "see_through"):
        before, after = (getattr(each.mappings, side).spread for each in (written, read))
        assert after.outputs == before.outputs
        assert after.sources == ("lens", "targets")
        for one, other in ((before.apart, after.apart), (before.joint, after.joint)):
            size = np.abs(one.coefficients).max(axis=0)
            assert np.all(np.abs(one.coefficients - other.coefficients) <= 0.5e-4 * size)
            assert np.any(np.abs(one.coefficients - other.coefficients) > 0.5e-6 * size)
    assert_same(read_again(tmp_path, read), read)


def test_a_spread_with_terms_of_its_own_comes_back(tmp_path: Path) -> None:
    orders = limited_orders(2, 1, 2, 3, 3)[::-1]
    read = read_again(tmp_path, of_both(orders=orders))
    for side in (read.mappings.display, read.mappings.see_through):
        assert isinstance(side, FittedModel)
        spread = present(side.spread)
        assert np.array_equal(spread.apart.orders, orders)
        assert np.array_equal(spread.joint.orders, orders)
    (eye,) = json.loads((tmp_path / "eye.json").read_text())["eyes"]
    assert "orders" in eye["display"]["spread"]["joint"]


def test_a_model_of_a_file_without_a_spread_refuses_its_standard_error(tmp_path: Path) -> None:
    read = read_again(tmp_path, model(bundle_display()))
    with pytest.raises(BadInputError, match="no covariance; fit it with this version: calibrate again"):
        narrowed(read.mappings.display, DisplayModel).sigma(np.array([500.0, 400.0]), EYE_BOX.centre)


def test_a_model_of_exact_data_without_factors_comes_back(tmp_path: Path) -> None:
    display = bundle_display()
    none = Polynomial(display.forward.orders, display.forward.box, np.zeros((15, 0)))
    read = read_again(tmp_path, model(dataclasses.replace(display, spread=Covariance(2, none, none))))
    assert narrowed(read.mappings.display, DisplayModel).sigma(np.array([500.0, 400.0]), EYE_BOX.centre) == 0.0


def test_a_standard_error_follows_from_the_file_by_its_description_alone(tmp_path: Path) -> None:
    written = of_both(display=static_display)
    (eye,) = json.loads(save_eye_models(tmp_path / "eye.json", [written]).read_text())["eyes"]
    record, pixel = eye["display"], np.array([120.0, 640.0])
    low, high = np.array(record["forward"]["low"]), np.array(record["forward"]["high"])
    orders = np.array([term["orders"] for term in record["forward"]["terms"]])
    terms = np.prod(np.cos(orders * np.arccos((2 * pixel - low - high) / (high - low))), axis=1)
    tx, ty = terms @ np.array([term["values"] for term in record["forward"]["terms"]])
    spread = record["spread"]
    apart, joint = (np.array(spread[name]["unit"]) * (terms @ spread[name]["values"]) for name in ("apart", "joint"))
    ((xx, xy), (_, yy)) = joint.reshape(2, 3) @ joint.reshape(2, 3).T + np.eye(2) * np.sum(apart**2)
    square = ((1 + ty**2) * xx - 2 * tx * ty * xy + (1 + tx**2) * yy) / (1 + tx**2 + ty**2) ** 2
    sigma = narrowed(written.mappings.display, DisplayModel).sigma(pixel, EYE_BOX.centre)
    np.testing.assert_allclose(np.sqrt(square) / ARCMIN, sigma, rtol=1e-3)


def spread_of(record: dict[str, Any]) -> dict[str, Any]:
    spread: dict[str, Any] = first(record)["display"]["spread"]
    return spread


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda s: s.pop("shared"), r"\[display\] \[spread\]: key 'shared' is missing"),
        (lambda s: s.update(shared=4), "'shared' is 4, but 'joint' has 3 variables"),
        (lambda s: s.update(sources=["lens"]), "'sources' names 1 variables, but 'shared' is 0"),
        (lambda s: s.update(rank=4), "unknown key 'rank'"),
        (lambda s: s["joint"]["unit"].pop(), r"\[joint\]: 'unit' must hold positive numbers, 2 for each variable"),
        (lambda s: s["apart"]["unit"].__setitem__(0, 0.0), r"\[apart\]: 'unit' must hold positive numbers"),
        (lambda s: s["joint"]["unit"].__setitem__(0, 1e9), r"\[joint\]: 'unit' makes factors above 100"),
        (lambda s: s["joint"]["values"].pop(), "'values' must be 15 lists of 6 whole numbers"),
        (lambda s: s["joint"]["values"][3].__setitem__(0, 0.5), "'values' must be 15 lists of 6 whole numbers"),
        (lambda s: s["joint"]["values"][3].__setitem__(0, 10**30), "'values' has a number beyond 64 bits"),
        (lambda s: s["joint"].update(orders=[[0, 0, 0, 0]] * 15), "has the same 'orders' twice"),
    ],
)
def test_a_fault_in_a_spread_is_one_sentence_with_its_name(
    tmp_path: Path, edit: Callable[..., Any], sentence: str
) -> None:
    path = save_eye_models(tmp_path / "eye.json", [of_both()])
    record = json.loads(path.read_text())
    edit(spread_of(record))
    path.write_text(json.dumps(record))
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_eye_model(path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < 300 + len(str(path))
