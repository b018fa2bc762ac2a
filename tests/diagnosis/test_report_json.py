"""The record as JSON: its keys, its numbers, and strictness."""

import json
from dataclasses import replace

import faked_diagnosis as fake
import numpy as np
import pytest

from wlr_render.diagnosis.diagnosis import ParameterValue
from wlr_render.diagnosis.gain import Gains, Rendered
from wlr_render.diagnosis.report_json import report_json
from wlr_render.evaluation.metrics import Summary

FIGURES = {"display_rms_px", "seethrough_rms_arcmin", "display_noise_floor_px", "seethrough_noise_floor_arcmin"}


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    return fake.explained(*fake.measured(tmp_path_factory.mktemp("session"), "target_scale"), "target_scale")


def strict(text):
    """JSON without NaN and infinities, which Python would read."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_the_record_has_the_keys_that_others_read(diagnosis):
    record = strict(report_json(fake.partly(diagnosis)))
    assert record["verdict"] == "partly explained"
    (cause,) = record["causes"]
    assert cause["name"] == "target_scale"
    assert cause["overlaps_with"] == [fake.RIVAL]
    assert (cause["held_out_gain"], cause["gain_sigma"]) == (80.87, 1.23)
    found = diagnosis.causes[0].parameters[0]
    assert cause["parameters"]["scale_x"] == {
        "value": found.value,
        "sigma": found.sigma,
        "unit": "%",
        "plausible": found.plausible,
    }
    assert record["outliers"] == [3]
    (moved,) = record["outlier_captures"]
    assert (moved["part"], moved["target_pose"], moved["capture"]) == ("display", None, 3)
    assert moved["shift_mm"] == [0.41, -0.72, 0.13]
    assert set(record["before"]) == set(record["after"]) >= FIGURES
    assert record["before"]["seethrough_rms_arcmin"] == diagnosis.before.see_through_rms_arcmin
    assert record["after"]["display_noise_floor_px"] == diagnosis.noise.display_rms_px
    left = record["unexplained"]
    assert (left["part"], left["bound_to"], left["rms_over_noise"]) == ("display", "panel pixels", 2.37)
    assert left["corrections"][0]["held_out_gain"] == 31.4
    assert record["noise"][0] == {
        "part": "display",
        "stated_px": 0.05,
        "within_px": 0.0931,
        "repeats_px": None,
        "measured_px": 0.0931,
        "error_px": 0.001,
        "used_px": 0.0931,
        "believable": False,
    }
    assert record["reasons"] == ["held-out captures gain 0.4 standard errors only"]


def test_nothing_is_null_and_limits_are_listed(diagnosis):
    record = strict(report_json(fake.nothing(diagnosis)))
    assert record["verdict"] == "no effect"
    assert (record["causes"], record["outliers"], record["unexplained"], record["gains"]) == ([], [], None, None)
    assert record["detection_limits"][1] == {
        "cause": "latency",
        "parameter": "latency",
        "unit": "ms",
        "smallest": 0.456,
    }


def test_numbers_that_json_lacks_become_null_and_numpy_numbers_plain(diagnosis):
    odd = (
        ParameterValue("a", np.float64(np.inf), np.nan, "%", 1.0),
        ParameterValue("b", np.float32(0.5), 0.0, "1", 1.0),
    )
    record = strict(report_json(replace(diagnosis, causes=(replace(diagnosis.causes[0], parameters=odd),))))
    parameters = record["causes"][0]["parameters"]
    assert parameters["a"] == {"value": None, "sigma": None, "unit": "%", "plausible": 1.0}
    assert parameters["b"]["value"] == 0.5


def test_gains_are_told_where_there_are_some(diagnosis):
    before, after = (Summary(rms, 0.1, 2 * rms, 0.3, 9, 0) for rms in (0.99, 0.169))
    record = strict(report_json(diagnosis, Gains(None, None, Rendered(before, after), None, ("no table.",))))
    assert record["gains"]["display_refitted"] is None
    assert record["gains"]["rendered_with_refitted_models"]["after_p95_arcmin"] == 0.338
    assert record["gains"]["lacking"] == ["no table."]


def test_a_part_that_the_session_lacks_is_null(diagnosis):
    nominal = diagnosis.observations.nominal
    record = strict(report_json(fake.explained(nominal, fake.ran(nominal), "latency")))
    assert record["before"]["display_rms_px"] is None
    assert record["before"]["runtime_rms_arcmin"] > record["after"]["runtime_rms_arcmin"] > 0
    assert record["causes"][0]["parameters"]["latency"]["value"] == pytest.approx(11.0, rel=0.05)
