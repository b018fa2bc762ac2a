import dataclasses
import json

import numpy as np
import pytest
from toy_device import display_captures, positions_in_plane, see_through_captures

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.errors import BadInputError
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.models.static import StaticSeeThrough

CAPTURES = EyeCaptures(display_captures(positions_in_plane(12)), see_through_captures(positions_in_plane(12)))


def test_eye_fit_names_what_it_is_and_goes_through_a_file(tmp_path):
    eye = fit_eye(CAPTURES, "planar", 2, 1)
    assert eye.mappings.name == "toy (planar N=2, see-through N=1)"
    path = save_eye_models(tmp_path / "right.json", [eye.model()])
    loaded = load_eye_model(path)
    assert loaded.device == "toy"
    assert loaded.report["display"]["residual_px"]["rms"] == eye.display.residual_px.rms
    pixel, viewpoint = CAPTURES.display.pixel, CAPTURES.display.viewpoint
    before = eye.mappings.display.view_dir_of_pixel(pixel, viewpoint).value
    np.testing.assert_array_equal(loaded.mappings.display.view_dir_of_pixel(pixel, viewpoint).value, before)


def test_point_per_pixel_goes_with_a_static_see_through():
    eye = fit_eye(CAPTURES, "point-per-pixel", 3, 2)
    assert isinstance(eye.mappings.see_through, StaticSeeThrough)
    assert (eye.display.kind, eye.see_through.kind) == ("point-per-pixel", "static")


def test_report_is_json_ready():
    record = fit_eye(CAPTURES, "planar", 1, 1).model().report
    assert json.loads(json.dumps(record))["see_through"]["residual_px"] is None


def test_a_display_without_see_through_is_refused():
    with pytest.raises(BadInputError, match="have no see-through part"):
        fit_eye(dataclasses.replace(CAPTURES, see_through=None))
