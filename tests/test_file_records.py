"""Records: what is written is read back, and each key beyond its bounds is refused with the file and the key."""

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, get_origin

import numpy as np
import pytest

from wlr_render.bench.bench import (
    TargetPose,
)
from wlr_render.bench.bench_file import SECTIONS
from wlr_render.captures.boards.april_grid import AprilGrid
from wlr_render.captures.boards.board import BoardTolerances
from wlr_render.captures.boards.board_keys import BoardPlace
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.photo_session import BoardPhotograph, CodeTable, GivenPose, StageAxis, StageTable
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES, rigid
from wlr_render.io.atomic_files import resource
from wlr_render.io.file_records import Keys, attributes, read_record, record_keys
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.mappings import Panel
from wlr_render.optics.device import PlacedPanel, PlacedSurface
from wlr_render.optics.raised import Offset
from wlr_render.optics.sag_surfaces import GaussianBump, SumOfProfiles, Toroid
from wlr_render.optics.surfaces import Conic, Ellipsoid
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions

WHERE = "file.toml [table]"
MANUAL = resource("docs", "files.md").read_text(encoding="utf-8")
DOCUMENTED = {
    **{f"bench `[{name}]`": kind for name, kind in SECTIONS.items()},
    "bench `[[target_pose]]`": TargetPose,
    "session `[stage]`": StageTable,
    "session, an axis": StageAxis,
    "session, a camera": PhotographFormat,
    "session `[[target]]`": GivenPose,
    "session, a photograph": BoardPhotograph,
    "board": BoardTolerances,
    "board of dots": DotBoard,
    "`charuco`": CharucoBoard,
    "`april-grid`": AprilGrid,
    "`chessboard`": Chessboard,
    "`circles`": CircleGrid,
    "device `[eye.panel]`": PlacedPanel,
    "device `[[eye.surface]]`": PlacedSurface,
    "`conic`": Conic,
    "`ellipsoid`": Ellipsoid,
    "`toroid`": Toroid,
    "`sum_of_profiles`": SumOfProfiles,
    "`offset`": Offset,
}
PLACE = BoardPlace(axes=FRAMES["opencv"])
POSE = rigid(np.eye(3), np.array([0.01, 0.02, 0.6]))
PARTS = {kind: kind() for name, kind in SECTIONS.items() if name not in ("camera", "stage", "target", "light")}
RECORDS = [
    SECTIONS["camera"](np.array([640.0, 480.0]), np.array([700.0, 710.0]), np.array([320.5, 240.0]), 0.1),
    replace(SECTIONS["stage"](np.ones(3)), backlash=np.array([1e-6, -1e-6])),
    SECTIONS["target"](POSE[None], np.ones(1)),
    *(replace(part, slip_time_s=9.0) if hasattr(part, "slip_time_s") else part for part in PARTS.values()),
    TargetPose(POSE, 0.02),
    StageTable("none", 1e-6, "camera"),
    CodeTable("opencv", PLACE.folder / "order.csv"),
    StageAxis("rotary", np.array([0.0, 0.6, -0.8]), 0.01, np.array([0.0, 0.001, 0.002])),
    BoardPhotograph(
        PLACE.folder, "a.png", 3, stage=np.zeros(3), time_s=5.0, temperature_c=20.0, regions=np.arange(4.0)[None]
    ),
    GivenPose(POSE, (0.01, 0.001), board_file="b.toml"),
    PhotographFormat(12, saturation=4000.0, mosaic="rggb", synthetic=True),
    BoardTolerances(),
    CharucoBoard(8, 6, 0.0254, 0.01905, "DICT_4X4_1000", legacy=True, margin_m=0.01),
    AprilGrid(6, 5, 0.04, 0.25, border_bits=1, first_id=4, first_at_bottom=False),
    Chessboard(9, 6, 0.02423, 0.02),
    CircleGrid(9, 7, 0.02, 0.012, 0.02),
    DotBoard(0.02, 0.01, 0.005, 0.02, np.eye(3, dtype=bool)),
    PlacedPanel(POSE, np.array([0.07, 0.04]), Panel(1920, 1080), np.array([0.3, -0.5])),
    Conic(12.5, -0.4),
    Ellipsoid(np.array([0.1, 0.12, 0.05])),
    Toroid(-0.3, 0.2),
    SumOfProfiles((5.0, -4.0), (0.5, -2.0)),
    GaussianBump(1e-5, 4e-3),
    Offset(Conic(5.0), 1e-3),
    BenchImperfections(),
    PhotoBenchOptions(places_mm=((0.0, 1.0, 2.0),)),
]


def given(
    record: Any,
) -> dict[Any, Any]:
    """The attributes that the record's table does not state."""
    kind: Any = type(record)  # mypy takes a class for hashable only where its objects are
    stated = {each.name for each in attributes(kind)}
    return {each.name: getattr(record, each.name) for each in fields(record) if each.name not in stated}


def keys_of(kind: Any) -> list[Any]:
    """The single keys of a record's forms."""
    forms = [each.form for each in attributes(kind)]
    return [key for form in forms for key in (form.parts if isinstance(form, Keys) else [form])]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_what_is_written_is_read_back(
    record: Any,
    tmp_path: Path,
) -> None:
    path = write_toml(tmp_path / "a.toml", record_keys(record, PLACE, defaults=True))
    again = read_record(type(record), read_toml(path), PLACE, **given(record))
    kind: Any = type(record)
    for each in attributes(kind):
        ours, theirs = getattr(record, each.name), getattr(again, each.name)
        assert type(ours) is type(theirs)
        assert np.array_equal(ours, theirs) or np.allclose(ours, theirs, rtol=0, atol=1e-9)


def beyond(key: Any, stated: Any) -> Iterator[Any]:
    """Values that a key refuses, in the shape of a value that it accepts."""
    bounds = (key.least, -1), (key.above, 0), (key.most, 1)
    for bound, side in [] if key.type in (bool, str, list) or get_origin(key.type) is Literal else bounds:
        if bound is not None:
            yield (np.zeros(np.shape(stated)) + bound + side * max(1.0, abs(bound))).tolist()
    yield {"a": 1}
    if key.choices or get_origin(key.type) is Literal:
        yield "none of these"


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_a_value_beyond_its_bounds_is_refused_with_file_and_key(
    record: Any,
) -> None:
    written = record_keys(record, PLACE, defaults=True)
    for key in keys_of(type(record)):
        name = next((name for name in key.names if name in written), "")
        for value in beyond(key._key(PLACE) if hasattr(key, "_key") else key, written[name]) if name else ():
            with pytest.raises(BadInputError) as caught:
                read_record(type(record), Table(written | {name: value}, WHERE), PLACE, **given(record))
            assert str(caught.value).startswith(f"{WHERE}: '{name}' ")
            assert "\n" not in str(caught.value)


def limits(key: Any) -> str:
    """The limits of a key in words, "" without any."""
    key = key._key(PLACE) if hasattr(key, "_key") else key
    if key.most is None and key.least is None:
        return f"`{key.name}` {key.rule.demand}" if key.rule else ""
    least = key.least if key.least is not None else 0 if key.type is int else -key.most
    low = f"above {key.above:g}" if key.above is not None else f"{least:g}"
    return f"`{key.name}` " + (f"{low} to {key.most:g}" if key.most is not None else f"{low} or more")


def test_the_manual_has_the_limits_of_every_key() -> None:
    for place, kind in DOCUMENTED.items():
        assert f"| {place} | {'; '.join(filter(None, map(limits, keys_of(kind))))} |\n" in MANUAL


def test_one_of_several_keys_alone_is_refused() -> None:
    keys = record_keys(RECORDS[0], PLACE)
    with pytest.raises(BadInputError, match="key 'height' is missing"):
        read_record(type(RECORDS[0]), Table({k: v for k, v in keys.items() if k != "height"}, WHERE), PLACE)
