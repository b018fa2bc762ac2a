import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memo import memoised, shared_folder
from numpy.typing import NDArray
from present import as_number, narrowed
from small_headsets import changed_device

from wlr_render.captures.correspondences import AnyCaptures, Captures
from wlr_render.captures.feature_captures import CommonErrors
from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.jobs.places_file import places_csv
from wlr_render.jobs.plan import next_places
from wlr_render.jobs.plan import plan as plan_job
from wlr_render.jobs.plan.plan import PLACES_FILE, PlanOptions, plan
from wlr_render.mappings import EyeBox
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning import planned_bench
from wlr_render.planning.designs import Design, offered, places_of, spread
from wlr_render.planning.place_choice import PlaceChoice, further_distance
from wlr_render.planning.planned_bench import PlannedBench, ReadingOptions
from wlr_render.planning.planned_errors import DesignErrors, PlannedFit, Scales, simulated_captures
from wlr_render.planning.search import DesignSearch, chosen_design, find_design
from wlr_render.report.blocks import Plot

DEVICE = "birdbath28"
ACCURACY = 0.2
OPTIONS = PlanOptions(DEVICE, accuracy_arcmin=ACCURACY, most_places=24)
KINDS = ("display", "see_through", "registration")


@pytest.fixture(scope="module", autouse=True)
def coarse_captures() -> Iterator[None]:
    """Half of the directions of a planned capture, each with less noise, so that a capture tells as much."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planned_bench, "GRID", (12, 9))
        yield


@pytest.fixture(scope="module")
def bench() -> PlannedBench:
    return birdbath_bench()


def birdbath_bench() -> PlannedBench:
    """With a stage that turns smoothly by 100 microradians, which no fit of captures contains."""
    truth = replace(traced_eye(load_device(DEVICE)), name=DEVICE)
    return PlannedBench(truth, OPTIONS.recipe, ReadingOptions(), OPTIONS.recipe.build())


@pytest.fixture(scope="module")
def found(coarse_captures: object, tmp_path_factory: pytest.TempPathFactory) -> tuple[DesignSearch, list[DesignErrors]]:
    return memoised(searched, shared_folder(tmp_path_factory))()


def searched() -> tuple[DesignSearch, list[DesignErrors]]:
    """The search, and errors of simulated sessions of the design that it recommends against the traced headset."""
    bench = birdbath_bench()
    search = find_design(bench, ACCURACY, OPTIONS.most_places, lambda text: None)
    fits = (PlannedFit.to(simulated_captures(bench, search.recommended.design.unit, seed)) for seed in (11, 12, 13, 14))
    return search, [search.predictor.simulated(fit) for fit in fits]


@pytest.fixture
def search(found: tuple[DesignSearch, list[DesignErrors]]) -> DesignSearch:
    return found[0]


@pytest.fixture
def sessions(found: tuple[DesignSearch, list[DesignErrors]]) -> list[DesignErrors]:
    return found[1]


def of_family(bench: PlannedBench, count: int) -> Design:
    return spread(bench.truth.eye_box, bench.field_reach, count)


@pytest.mark.parametrize("kind", KINDS)
def test_predicted_errors_are_those_of_simulated_sessions(
    search: DesignSearch, sessions: list[DesignErrors], kind: str
) -> None:
    found = np.sqrt(np.mean([getattr(each, kind).rms ** 2 for each in sessions]))
    assert 0.8 < getattr(search.recommended.errors, kind).rms / found < 1.25


def test_the_recommended_design_reaches_the_wanted_accuracy(search: DesignSearch, sessions: list[DesignErrors]) -> None:
    assert search.reaches
    assert len(search.recommended.design) < OPTIONS.most_places
    assert np.median([each.registration.p95 for each in sessions]) < ACCURACY


def test_a_few_places_less_do_not_reach_it(bench: object, search: DesignSearch) -> None:
    fewer = [each for tried in search.tried.values() for each in tried]
    fewer = [each for each in fewer if len(each.design) < len(search.recommended.design)]
    assert fewer
    assert all(each.p95 > ACCURACY for each in fewer)


def test_more_places_and_smaller_errors_never_predict_worse(bench: PlannedBench, search: DesignSearch) -> None:
    sizes = [search.predictor.errors(of_family(bench, count).unit).registration.rms for count in (9, 11, 14, 18, 24)]
    assert sizes == sorted(sizes, reverse=True)
    now = search.recommended.errors
    for changed in search.limits.values():
        assert changed.registration.rms <= 1.001 * now.registration.rms
    for scales in (Scales(noise=2.0), Scales(random=2.0), Scales(smooth=2.0)):
        worse = search.predictor.errors(search.recommended.design.unit, scales)
        assert all(getattr(worse, kind).rms >= getattr(now, kind).rms for kind in KINDS)


def test_smooth_errors_of_the_stage_cancel_in_registration_but_not_in_the_display(search: DesignSearch) -> None:
    unit = search.recommended.design.unit
    now, without = (search.predictor.errors(unit, Scales(smooth=smooth)) for smooth in (5.0, 0.0))
    display, see_through, registration = (
        getattr(now, kind).rms ** 2 - getattr(without, kind).rms ** 2 for kind in KINDS
    )
    assert now.display.rms > 2.0 * without.display.rms
    assert registration < 0.5 * (display + see_through)  # variances; their sum if they were independent


def rest_urad(bench: PlannedBench, unit: NDArray[Any]) -> float:
    """Rms rotation per axis that calibration leaves of the smooth errors, over many stages."""
    places = bench.places(unit)
    rest = np.array([bench.curve(draw)(places)[:, :3] for draw in range(40)])
    return 1e6 * float(np.std(rest - rest.mean(axis=1, keepdims=True)))


def with_sizes(bench: PlannedBench, **sizes: Any) -> PlannedBench:
    recipe = bench.recipe
    changed = replace(recipe.bench, imperfections=replace(recipe.bench.imperfections, **sizes))
    return replace(bench, recipe=replace(recipe, bench=changed))


def test_calibration_of_the_stage_leaves_what_its_random_errors_make(bench: PlannedBench) -> None:
    unit = of_family(bench, 16).unit
    exact = with_sizes(bench, turn_jitter_urad=0.0, repeatability_um=0.0)
    assert rest_urad(exact, unit) < 1e-6
    found = rest_urad(bench, unit)
    # Without calibration it is 100; of three levels of each axis without random errors 50 would remain.
    assert 3.0 < found < 10.0
    assert rest_urad(with_sizes(bench, turn_jitter_urad=20.0), unit) == pytest.approx(2.0 * found)


@pytest.mark.parametrize("in_depth", [False, True])
def test_places_in_depth_need_a_stage_calibrated_in_depth(bench: PlannedBench, in_depth: bool) -> None:
    own = replace(with_sizes(bench, turn_jitter_urad=0.0, repeatability_um=0.0), in_depth=in_depth)
    steps = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]])
    assert (rest_urad(own, steps) < 1e-6) == in_depth
    # Two passes of 15 positions in a plane; two more levels of z, each twice.
    assert own.photographs(12)["board without the headset"] == (34 if in_depth else 30)


def test_places_are_in_random_order(bench: PlannedBench) -> None:
    """A drift does not look like optics."""
    for count in (16, 25, 49, 81):
        unit = of_family(bench, count).unit
        written = np.loadtxt(io.StringIO(places_csv(unit)), delimiter=",", skiprows=1)
        assert sorted(map(tuple, written)) == sorted(map(tuple, (1e3 * unit).round(3)))
        assert np.abs(np.corrcoef(np.arange(count), written[:, :2].T)[0, 1:]).max() < 0.6


@pytest.fixture(scope="module")
def choice(bench: PlannedBench, found: tuple[DesignSearch, list[DesignErrors]]) -> PlaceChoice:
    """Places in depth, then spreads of 16 and of 25 in the middle plane."""
    box, reach = bench.truth.eye_box, bench.field_reach
    unit = np.concatenate([offered(box, reach, True), of_family(bench, 16).unit, of_family(bench, 25).unit])
    return PlaceChoice.of(found[0].predictor.pilot, bench.places(unit), (0.4, 1.0), is_added=False)


def test_each_chosen_place_lowers_the_error_and_exchanges_lower_it_further(choice: PlaceChoice) -> None:
    taken, errors = choice.one_by_one(16)
    assert len(set(taken)) == 16
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(choice.error(taken))
    chosen = choice.chosen(16)
    assert len(set(chosen)) == 16
    assert choice.error(chosen.tolist()) < 0.98 * errors[-1]


def test_a_place_that_sees_nothing_tells_nothing_and_leaves_the_others_their_numbers(
    search: DesignSearch, choice: PlaceChoice
) -> None:
    pilot, places = search.predictor.pilot, choice.places[:3]
    blind = PlaceChoice.of(pilot, np.insert(places, 1, np.nan, axis=0), (0.4, 1.0), is_added=False)
    seeing = PlaceChoice.of(pilot, places, (0.4, 1.0), is_added=False)
    assert blind.error([0, 1, 2, 3]) == pytest.approx(seeing.error([0, 1, 2]))
    assert blind.error([2]) == pytest.approx(seeing.error([1]))


def test_the_choice_predicts_as_the_whole_posterior_does(
    choice: PlaceChoice, bench: PlannedBench, search: DesignSearch
) -> None:
    for count, rows in ((16, range(92, 108)), (25, range(108, 133))):
        whole = search.predictor.errors(of_family(bench, count).unit, Scales(smooth=0.0)).registration.rms
        assert choice.error(rows) == pytest.approx(whole, rel=0.1)


def test_16_places_chosen_in_depth_predict_better_than_25_of_a_spread_in_the_plane(choice: PlaceChoice) -> None:
    assert choice.error(choice.chosen(16).tolist()) < 0.9 * choice.error(range(108, 133))


@pytest.mark.parametrize("count", [10, 16])
def test_a_chosen_design_never_predicts_worse_than_a_spread_of_as_many_places(
    search: DesignSearch, bench: PlannedBench, count: int
) -> None:
    chosen, lattice = (
        search.predictor.errors(each.unit, Scales(smooth=0.0)).registration.rms
        for each in (chosen_design(search.predictor, count), of_family(bench, count))
    )
    assert chosen <= 1.01 * lattice  # the choice averages over fewer directions


def test_rays_from_offered_places_meet_the_middle_plane_in_the_region_of_places(bench: PlannedBench) -> None:
    box, reach = bench.truth.eye_box, bench.field_reach
    away = places_of(offered(box, reach, True), box, reach) - box.centre
    assert np.abs(away[:, 2]).max() == pytest.approx(0.5 * box.size[2])
    assert np.all(np.abs(away[:, :2]) + np.abs(away[:, 2:]) * reach <= bench.reach_m + 1e-12)
    assert np.all(offered(box, reach, False)[:, 2] == 0.0)


def test_a_further_target_lowers_the_error(search: DesignSearch, bench: PlannedBench) -> None:
    places = bench.places(of_family(bench, 12).unit)
    distance, ratio = further_distance(search.predictor.pilot, places, (0.4, 1.0), is_added=False)
    assert distance not in (0.4, 1.0)
    assert 0.6 < ratio < 1.0
    every, _ = further_distance(search.predictor.pilot, places, (0.3, 0.6, 1.5, 3.0), is_added=False)
    assert every in (0.3, 0.6, 1.5, 3.0)  # once more


def test_an_accuracy_out_of_reach_is_said_to_be(search: DesignSearch) -> None:
    from wlr_render.jobs.plan.plan_report import plan_report

    report = plan_report(replace(search, reaches=False), 0.001, 2.0)
    assert report.verdict.startswith("The wanted 0.001' is not reached.")


def test_the_report_states_places_photographs_and_errors(
    search: DesignSearch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_job, "find_design", lambda *_: search)
    report = plan(replace(OPTIONS, out=tmp_path))
    count = len(search.recommended.design)
    assert report.verdict.startswith(
        f"{count} camera places, {count * 46 + 2 * (count + 1) + 30 + 4 + 36} photographs, "
    )
    assert f"this reaches the wanted {ACCURACY:g}'" in report.verdict
    # The first line and the table of designs predict from different sessions; both say so.
    stated = search.recommended.p95
    assert (
        f"{stated:.2g}' at 95 % of the eye box, as predicted from a simulated session of this design" in report.verdict
    )
    (designs,) = [each for each in report.tables if each.title == "Predicted error by number of camera places"]
    counts = [as_number(row[0]) for row in designs.rows]
    assert counts == sorted(counts)
    assert sum(row[-1] == "recommended" for row in designs.rows) <= 1
    assert all(
        as_number(row[3]) < as_number(row[4])
        and as_number(row[5]) < as_number(row[6])
        and as_number(row[7]) < as_number(row[8])
        for row in designs.rows
    )
    (plot,) = [each for each in report.blocks if isinstance(each, Plot) and each.title == designs.title]
    spreads, *_, own, _ = plot.data
    ends = [y + above for y, above in zip(spreads["y"], spreads["error_y"]["array"], strict=True)]
    assert ends == pytest.approx(
        [row[8] for row in designs.rows if narrowed(row[1], str).startswith("spread")], rel=1e-3
    )
    assert (own["x"], own["y"][0] + own["error_y"]["array"][0]) == ([count], pytest.approx(stated, rel=1e-3))
    assert f"itself then predicts {stated:.3g}' at 95 %, the figure stated above" in designs.notes[0]
    with (tmp_path / PLACES_FILE).open(newline="", encoding="utf-8") as file:
        rows = [[float(each) for each in row.values()] for row in csv.DictReader(file)]
    expected = 1e3 * (search.predictor.bench.places(search.recommended.design.unit) - load_box().centre)
    assert sorted(rows) == pytest.approx(np.array(sorted(expected.round(3).tolist())), abs=1e-3)
    assert (tmp_path / "report.html").is_file()


def load_box() -> EyeBox:
    return traced_eye(load_device(DEVICE)).eye_box


@pytest.fixture(scope="module")
def calibration(bench: PlannedBench, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A calibration from places of the left half of the eye box alone, whose captures share errors of the lens."""
    folder = tmp_path_factory.mktemp("calibration")
    unit = of_family(bench, 12).unit * [0.5, 1.0, 1.0] - [0.5, 0.0, 0.0]
    captures = simulated_captures(bench, unit, 5)
    display, see_through = captures.both
    Captures(_with_lens_error(display), _with_lens_error(see_through)).save(folder / "captures-right.npz")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("fit_display", "fit_see_through"):
            patch.setattr(next_places, name, first_result(getattr(next_places, name)))
        yield folder


def first_result(fit: Callable[..., Any]) -> Callable[..., Any]:
    """A function that fits once: all plans here are of the same captures."""
    kept: list[Any] = []

    def fitted(captures: AnyCaptures) -> Any:
        if not kept:
            kept.append(fit(captures))
        return kept[0]

    return fitted


def _with_lens_error(captures: AnyCaptures) -> AnyCaptures:
    """Captures that share an error of the lens: a scale of 1e-3, which cancels between display and see-through."""
    by_tangents = Polynomial(np.eye(2, dtype=int), Box(-np.ones(2), np.ones(2)), 1e-3 * np.eye(2))
    visits = np.unique(captures.visits[0])
    common = CommonErrors(("lens",), visits, np.zeros((len(visits), 6, 1)), by_tangents)
    return replace(captures, device_from_camera=np.eye(3), common=common)


def test_places_are_added_where_a_calibration_has_none(calibration: Path, tmp_path: Path) -> None:
    report = plan(PlanOptions(DEVICE, calibration=calibration, accuracy_arcmin=0.01, add=2, out=tmp_path))
    added = np.loadtxt(tmp_path / PLACES_FILE, delimiter=",", skiprows=1)
    assert added.shape == (2, 3)
    assert np.all(added[:, 0] > 1.0)
    (table,) = [each for each in report.tables if each.title.startswith("Places to add")]
    p95 = [as_number(row[-1]) for row in table.rows]
    assert p95 == sorted(p95, reverse=True)
    assert p95[-1] < 0.5 * p95[0]
    assert "does not reach the wanted 0.01'" in report.verdict


def test_a_calibration_that_is_good_enough_needs_no_places(calibration: Path, tmp_path: Path) -> None:
    report = plan(PlanOptions(DEVICE, calibration=calibration, accuracy_arcmin=100.0, out=tmp_path))
    assert "add no places" in report.verdict
    assert (tmp_path / PLACES_FILE).read_text().strip() == "x_mm,y_mm,z_mm"


def test_captures_without_see_through_are_refused(bench: PlannedBench, tmp_path: Path) -> None:
    captures = simulated_captures(bench, of_family(bench, 9).unit, 5)
    Captures(captures.display).save(tmp_path / "captures-right.npz")
    with pytest.raises(BadInputError, match="have no see-through part"):
        plan(PlanOptions(DEVICE, calibration=tmp_path, out=tmp_path))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--depths-m", "0.5", "0.5"], "see-through needs targets at two distances at least"),
        (["--add", "3"], "--add is used with --calibration only"),
        (["--eye", "left"], "has no left eye"),
    ],
)
def test_bad_options_get_a_sentence(
    options: Sequence[str], sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["plan", DEVICE, *options, "--out", str(tmp_path)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert sentence in said


def test_a_fitted_model_is_no_prescription(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="is a fitted model; a plan needs the headset's prescription"):
        plan(PlanOptions("model.json", out=tmp_path))


def test_a_panel_whose_middle_is_not_seen_is_refused(tmp_path: Path) -> None:
    device = changed_device(tmp_path, "no_optics", ("[1280, 720]", "[4, 4]"))
    with pytest.raises(BadInputError, match="no_optics: the 8 x 8 pixels in the middle of the panel are not all seen"):
        plan(PlanOptions(device, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
