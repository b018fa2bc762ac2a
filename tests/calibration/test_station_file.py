"""Station files whose JSON is sound and whose content is not."""

import json
from pathlib import Path
from typing import Any

import pytest
from corpus.base_texts import STATION
from present import narrowed

from wlr_render.calibration.bench.station_file import read_lens, read_station
from wlr_render.errors import BadInputError


@pytest.mark.parametrize(
    ("changes", "camera", "sentence"),
    [
        ({"units": {"length": "mm", "angle": "rad", "pixel": "px"}}, {}, "'units' must be"),
        ({}, {"size_px": [640.5, 480]}, "'size_px' must be two whole numbers"),
        ({}, {"focal_px": [600.0, 100.0]}, "no camera's two differ by 3 times"),
        ({}, {"focal_px": [4.0, 4.0]}, "not in millimetres"),
        ({}, {"residual": {"counts": [2, 30], "amplitude_px": [[0.0, 0.0]]}}, "'counts' must be two whole numbers"),
        ({}, {"residual": {"counts": [2, 2], "amplitude_px": [[0.0, 0.0]]}}, "'amplitude_px' must have 2 x 2 rows"),
        ({}, {"residual": {"counts": [1, 1], "amplitude_px": [[0.0, 2e3]]}}, "'amplitude_px' has numbers above 100"),
        ({}, {"residual": {"counts": [1, 1], "amplitude_px": [[0.0, None]]}}, "'amplitude_px'"),
        ({}, {"residual": {"amplitude_px": [[0.0, 0.0]]}}, "'counts'"),
    ],
)
def test_a_station_that_nobody_has_is_refused(
    tmp_path: Path, changes: dict[str, dict[str, str]], camera: dict[str, Any], sentence: str
) -> None:
    path = tmp_path / "station-right.json"
    path.write_text(json.dumps(STATION), encoding="utf-8")
    assert read_lens(read_station(path).table("eyeball_camera")).size_px == (320, 240)
    content = STATION | changes | {"eyeball_camera": narrowed(STATION["eyeball_camera"], dict) | camera}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(BadInputError, match=sentence) as caught:
        read_lens(read_station(path).table("eyeball_camera"))
    assert str(caught.value).startswith(str(path))
