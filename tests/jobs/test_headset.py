import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.bench_effects import BenchEffect, optics_with_effects
from wlr_render.bench.bench_file import save_bench
from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.jobs.headset import effect_warnings, headset_path, open_colours, open_eye, require_in_eye_box
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.numerics.waves import Wave
from wlr_render.optics.device_file import load_device
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.traced_mappings import TracedDisplay, traced_eye


def test_a_device_is_traced_and_a_model_is_read(straight_device: str, model_file: str) -> None:
    traced = open_eye(straight_device, "left")
    assert (traced.name, traced.eye) == ("no_optics (traced)", "left")
    fitted = open_eye(Path(model_file))
    assert (fitted.name, fitted.eye) == ("fitted", "right")
    assert open_eye("no_optics").display.panel.width_px == 1280


def test_a_bench_is_its_device_with_the_heights_of_its_effects(tmp_path: Path) -> None:
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([900.0, 900.0]), np.array([640.0, 300.0]), 0.1)
    device = load_device("northstar")
    middle = device.eyes["right"].eye_box.centre
    bench = Bench(device, "right", camera, Stage(middle), Target(np.zeros((0, 4, 4)), np.zeros(0)))
    box = Box(np.full(2, -20.0), np.full(2, 20.0))
    tilted = BenchEffect("combiner", "all surfaces", Polynomial(np.array([[1, 0]]), box, np.array([[20.0]])))
    path = save_bench(replace(bench, effects=(tilted,)), tmp_path / "bench.toml")
    ahead = np.array([[0.05, -0.1, -1.0]])
    stated, raised = open_eye(path, "right"), optics_with_effects(device.eyes["right"], (tilted,))
    pixel = stated.display.pixel_of_view_dir(ahead, middle).value
    expected = TracedDisplay(raised, GREEN_UM).pixel_of_view_dir(ahead, middle).value
    np.testing.assert_allclose(pixel, expected, atol=1e-6)
    assert np.abs(pixel - open_eye("northstar", "right").display.pixel_of_view_dir(ahead, middle).value).max() > 1.0
    assert effect_warnings(path) == effect_warnings("northstar") == []
    of_file, shipped = (
        open_eye(spec, "left").display.pixel_of_view_dir(ahead, middle).value for spec in (path, "northstar")
    )
    np.testing.assert_array_equal(of_file, shipped)


def test_effects_of_a_bench_that_its_maps_do_not_have_are_said(straight_device: str, tmp_path: Path) -> None:
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([900.0, 900.0]), np.array([640.0, 300.0]), 0.1)
    device = load_device(straight_device)
    bench = Bench(device, "right", camera, Stage(np.zeros(3)), Target(np.zeros((0, 4, 4)), np.zeros(0)))
    warped, swing = (
        BenchEffect(station, displaces, Wave(0, 500.0, np.ones((2, outputs))))
        for station, displaces, outputs in (("panel", "shift by viewpoint", 2), ("time", "pose", 6))
    )
    path = save_bench(replace(bench, effects=(warped, swing)), tmp_path / "bench.toml")
    (said,) = effect_warnings(path)
    assert "do not have its effects of panel (shift by viewpoint); render with models fitted to the session" in said


def test_the_eye_box_is_a_border_with_a_micrometre_of_slack(straight_device: str) -> None:
    eye = open_eye(straight_device)
    corner = eye.eye_box.at(np.ones(3))
    require_in_eye_box(eye, corner, "here")
    require_in_eye_box(eye, corner + 0.9e-6, "here")
    with pytest.raises(BadInputError) as refused:
        require_in_eye_box(eye, corner + [0.0, 0.001, 0.0], "eyes.txt at 2.5 s")
    sentence = str(refused.value)
    assert sentence.startswith("eyes.txt at 2.5 s: the viewpoint (5.00, 5.00, 3.00) mm lies outside the eye box of")
    assert "(-5.00, -4.00, -3.00) to (5.00, 4.00, 3.00) mm" in sentence


def test_a_device_is_traced_in_red_green_and_blue() -> None:
    channels = open_colours("freeform40")
    viewpoint = channels[0].eye_box.centre
    ray = np.array([0.2, -0.1, -1.0]) / np.sqrt(1.05)
    red, green, blue = (each.see_through.real_ray_of_view_dir(ray, viewpoint).value[3:] for each in channels)
    of_p3_green = traced_eye(load_device("freeform40"), "right", 0.5442).see_through
    np.testing.assert_array_equal(green, of_p3_green.real_ray_of_view_dir(ray, viewpoint).value[3:])
    # Glass bends blue the most: the colours lie in their order.
    assert directions.angle_between(red, blue) == pytest.approx(
        directions.angle_between(red, green) + directions.angle_between(green, blue), rel=1e-3
    )
    assert directions.angle_between(green, blue) > directions.angle_between(red, green) > 0


def test_three_models_are_three_colours(model_file: str, tmp_path: Path) -> None:
    record = json.loads(Path(model_file).read_text(encoding="utf-8"))
    files = [tmp_path / f"{name}.json" for name in ("red", "green", "blue")]
    for path in files:
        record["eyes"][0]["name"] = path.stem
        path.write_text(json.dumps(record), encoding="utf-8")
    red, green, blue = files
    assert [each.name for each in open_colours(green, "right", red, blue)] == ["red", "green", "blue"]


@pytest.mark.parametrize("part", ["panel", "eye box"])
def test_colours_of_different_headsets_are_refused(model_file: str, tmp_path: Path, part: str) -> None:
    record = json.loads(Path(model_file).read_text(encoding="utf-8"))
    (eye,) = record["eyes"]
    if part == "panel":
        eye["display"]["panel"]["width_px"] += 1
    else:
        eye["eye_box"]["size_m"][0] *= 1.1
    other = tmp_path / "other.json"
    other.write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"other\.json: has another panel or eye box than the green model"):
        open_colours(model_file, "right", Path(model_file), other)
    with pytest.raises(BadInputError, match=r"other\.json: has another panel or eye box than the green model"):
        open_colours(model_file, "right", other, Path(model_file))


def test_models_of_red_and_blue_go_with_a_model_of_green(model_file: str) -> None:
    for red, blue in ((None, None), (Path(model_file), None), (None, Path(model_file))):
        with pytest.raises(BadInputError, match=r"is a model of one colour; give --red-model and --blue-model as well"):
            open_colours(model_file, "right", red, blue)
    with pytest.raises(BadInputError, match="no_optics: is a device, which is traced in all colours"):
        open_colours("no_optics", "right", Path(model_file), Path(model_file))


def test_a_headset_is_a_file_of_this_path(model_file: str, straight_device: str) -> None:
    assert headset_path(model_file) == Path(model_file)
    assert headset_path(straight_device) == Path(straight_device)
    assert headset_path("northstar").is_file()
