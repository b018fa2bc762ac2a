"""station.json: read back as written, and refused where it is something else."""

import json

import numpy as np
import pytest
from synthetic_station import DEVICE_FROM_TRACKING, EYEBALL, REFERENCE, TRACKING, bench, station_of

from wlr_render.calibration.station_file import load_station, save_station
from wlr_render.errors import BadInputError


@pytest.fixture(scope="module")
def station():
    """Its stage was moved along x and y, never along z."""
    return station_of(bench(1))


@pytest.fixture
def path(station, tmp_path):
    return save_station(tmp_path / "station.json", station, EYEBALL, TRACKING, DEVICE_FROM_TRACKING)


def test_what_is_written_is_read_back(station, path):
    again = load_station(path)
    for ours, theirs in ((again.eyeball_camera, EYEBALL), (again.tracking_camera, TRACKING)):
        assert ours.size_px == theirs.size_px
        for name in ("focal_px", "centre_px", "distortion"):
            assert np.array_equal(getattr(ours, name), getattr(theirs, name))
    assert np.array_equal(again.device_from_tracking, DEVICE_FROM_TRACKING)
    assert np.array_equal(again.at_reference, station.at_reference)
    assert np.isnan(again.axes[:, 2]).all()


def test_the_camera_is_placed_as_the_station_itself_places_it(station, path):
    again = load_station(path)
    for travel in ([0.0, 0.0, 0.0], [0.004, -0.003, 0.0]):
        reading = station.stage.reference + travel
        assert np.allclose(again.device_from_camera(reading), station.device_from_camera(reading), rtol=0, atol=1e-12)


def test_a_reading_of_an_axis_that_never_moved_is_refused(path):
    with pytest.raises(BadInputError, match="along an axis that no photograph without the headset varies"):
        load_station(path).device_from_camera(REFERENCE + [0.0, 0.0, 0.002])


def test_every_pose_has_its_uncertainty_in_the_file(station, path):
    content = json.loads(path.read_text(encoding="utf-8"))
    poses = [content["stage"]["device_from_camera"], *content["device_from_target"].values()]
    assert len(poses) == 3
    assert np.allclose(poses[1]["matrix"], station.device_from_target[0].b_from_a)
    assert all(np.all(np.array(pose[name]) > 0) for pose in poses for name in ("sigma_mm", "sigma_arcmin"))
    jitter = station.stage.jitter
    assert content["stage"]["repeatability"] == {
        "translation_um": 1e6 * jitter.translation_m,
        "rotation_urad": 1e6 * jitter.rotation_rad,
    }
    assert len(content["checks"]) == len(station.checks)


def spoilt(content, change):
    change(content)
    return content


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda content: content.update(format="wlr-model"), "'format' is 'wlr-model'; it must be one of wlr-station"),
        (lambda content: content.update(version=2), "has another version than 1"),
        (lambda content: content.pop("stage"), "'stage' is missing"),
        (lambda content: content["stage"].pop("axes_in_device"), "'axes_in_device' must be 3 columns"),
        (lambda content: content["stage"].update(axes_in_device=[[1.0, 0.0], None, None]), "must be 3 columns"),
        (lambda content: content["eyeball_camera"].update(focal_px=[700.0]), "'focal_px' must be a list of 2"),
        (lambda content: content.pop("device_from_tracking"), "'device_from_tracking' is missing"),
    ],
)
def test_other_files_are_refused(path, change, complaint):
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(spoilt(content, change)), encoding="utf-8")
    with pytest.raises(BadInputError, match=complaint) as caught:
        load_station(path)
    assert str(path) in str(caught.value)


def test_files_that_cannot_be_read_are_refused(path, tmp_path):
    with pytest.raises(BadInputError, match="`calibrate photos` writes it"):
        load_station(tmp_path / "none.json")
    path.write_text(path.read_text(encoding="utf-8")[:200], encoding="utf-8")
    with pytest.raises(BadInputError, match="is not a station file, or is cut short"):
        load_station(path)
    path.write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(BadInputError, match="its JSON is not an object"):
        load_station(path)
