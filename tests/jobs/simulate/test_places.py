"""Sessions at the places of a plan: they are read as written, visited in their order, and kept in the recipe."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from present import present
from small_photo_session import far_panel_device, make_small

from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.errors import BadInputError
from wlr_render.jobs.places_file import in_random_order, places_csv, read_places
from wlr_render.jobs.simulate import SimulateOptions, simulate
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning.designs import offered, places_of, spread
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.photographs.photo_bench import half_travel
from wlr_render.simulation.photographs.photo_plan import plan_photographs, planned_session, true_camera_poses
from wlr_render.simulation.photographs.recipe import SimulationRecipe, values_of

DEVICE = "birdbath28"
HEADER = "x_mm,y_mm,z_mm"
ROWS = ((1.5, -0.25, 0.0), (-2.0, 1.0, 1.0), (0.125, 0.5, -1.0))


def written(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "places.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def read_recipe(options: SimulateOptions) -> SimulationRecipe:
    return options.recipe


@pytest.fixture
def options(tmp_path: Path) -> SimulateOptions:
    places = written(tmp_path, *(",".join(map(str, row)) for row in ROWS))
    return SimulateOptions(DEVICE, places=places, out=tmp_path / "session")


def test_places_of_every_design_are_read_as_they_were_written(tmp_path: Path) -> None:
    truth = traced_eye(load_device(DEVICE))
    reach, box = CaptureSetup(truth).field.reach, truth.eye_box
    for unit in (spread(box, reach, 25).unit, spread(box, reach, 81).unit, offered(box, reach, True)):
        places = places_of(unit, box, reach) - box.centre
        path = tmp_path / "places.csv"
        path.write_text(places_csv(places), encoding="utf-8")
        again = read_places(path, half_travel(truth), "xyz", 100)
        assert again == pytest.approx(1e3 * in_random_order(places), abs=5.01e-4)


def test_a_session_visits_the_places_in_their_order(options: SimulateOptions) -> None:
    recipe = options.recipe
    assert recipe.viewpoints == 3
    bench = recipe.build()
    plan = plan_photographs(bench, recipe.viewpoints)
    assert plan.sweep == pytest.approx(1e-3 * np.array(ROWS), abs=1e-12)
    visits = true_camera_poses(bench, plan)
    session = planned_session(options.out, bench, plan, visits, cast(Pattern, None))
    stated = np.array([each.stage for each in session.display])
    assert stated == pytest.approx(plan.sweep, abs=5e-6)
    assert len(session.see_through) == (3 + 1) * len(bench.device_from_target)


def test_places_in_depth_have_five_levels_of_depth_without_the_headset(
    options: SimulateOptions, tmp_path: Path
) -> None:
    levels = [len(np.unique(plan_photographs(options.recipe.build(), 3).bare[:, 2]))]
    flat = replace(options, places=written(tmp_path, "1,0,0", "-1,1,0"))
    levels.append(len(np.unique(plan_photographs(flat.recipe.build(), 2).bare[:, 2])))
    assert levels == [5, 3]


def test_places_are_among_the_values_by_which_a_session_is_told(options: SimulateOptions, tmp_path: Path) -> None:
    recipe = options.recipe
    before = values_of(recipe)
    present(options.places).write_text(HEADER + "\n1,1,0\n2,2,0\n1,2,0\n", encoding="utf-8")
    now = values_of(options.recipe)
    assert [name for name in before if before[name] != now[name]] == ["places_mm"]


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (["1,2"], r"places\.csv line 2: 2 columns where 3 are expected \(x_mm,y_mm,z_mm\)"),
        (["1,2,0", "1,left,0"], r"places\.csv line 3: column 2 is 'left', not a number"),
        (["1,2,0", "", "nan,2,0"], r"places\.csv line 4: column 1 is nan; leave out"),
        (["40,2,0"], r"places\.csv line 2: x_mm is 40; rays through the eye box end \d+(\.\d+)? mm from its centre"),
        (["0,0,-9"], r"places\.csv line 2: z_mm is -9; rays through the eye box end"),
        (["0,0,0"] * 1001, r"places\.csv: has 1001 places; it must have at most 1000\."),
        ([], r"places\.csv: has no rows; is a list of places empty"),
    ],
)
def test_faulty_places_are_refused_in_one_sentence(tmp_path: Path, rows: Sequence[str], sentence: str) -> None:
    options = SimulateOptions(DEVICE, places=written(tmp_path, *rows), out=tmp_path / "session")
    with pytest.raises(BadInputError, match=sentence) as caught:
        read_recipe(options)
    assert "\n" not in str(caught.value)
    assert not options.out.exists()


@pytest.mark.parametrize(("header", "row"), [("x,y,z", "1,1,0"), ("y_mm,x_mm,z_mm", "1,1,0"), ("x_mm,y_mm", "1,1")])
def test_other_columns_are_refused(tmp_path: Path, header: str, row: str) -> None:
    with pytest.raises(BadInputError, match=r"places\.csv: the columns are '.*'; they must be x_mm,y_mm,z_mm"):
        read_recipe(SimulateOptions(DEVICE, places=written(tmp_path, row, header=header)))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"nowhere\.csv: there is no such file"):
        read_recipe(SimulateOptions(DEVICE, places=tmp_path / "nowhere.csv"))


def test_a_stage_without_the_axis_of_a_place_is_refused(options: SimulateOptions) -> None:
    with pytest.raises(BadInputError, match=r"line 3: z_mm is 1, but the stage xy does not move along z; write 0"):
        read_recipe(replace(options, stage="xy"))


@pytest.mark.parametrize("other", [{"viewpoints": 9}, {"sampling": "volumetric"}])
def test_places_exclude_other_choices_of_places(options: SimulateOptions, other: Mapping[str, Any]) -> None:
    with pytest.raises(BadInputError, match=r"--(viewpoints|sampling) has no effect with --places; leave out one"):
        replace(options, **other)


@pytest.mark.slow
def test_an_interrupted_session_continues_at_its_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_small(monkeypatch)
    options = SimulateOptions(
        far_panel_device(tmp_path),
        places=written(tmp_path, "2,1,0", "-1,-2,0"),
        camera=(160, 128),
        depths_m=(0.6, 1.2),
        out=tmp_path / "session",
    )
    simulate(options)
    session = load_photo_session(options.out)
    readings = np.array([each.stage for each in session.display])
    assert readings[:, :2] == pytest.approx(1e-3 * np.array([[2.0, 1.0], [-1.0, -2.0]]), abs=5e-6)
    (lost,) = options.out.glob("display/01/000_*.png")
    lost.unlink()
    assert simulate(options).verdict.startswith("1 photographs taken, ")
