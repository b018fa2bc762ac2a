"""`calibrate --validate`: what the report says to believe, and runs that are interrupted."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_photo_session import in_this_process

import wlr_render as wlr
from wlr_render.calibration import validation
from wlr_render.calibration.validation import BANDS, NOISE, QUARTERS, Ratio
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.jobs.calibrate import validate
from wlr_render.jobs.calibrate.calibrate import calibrate
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, FitOptions
from wlr_render.jobs.calibrate.validate import Validation
from wlr_render.mappings import Eye
from wlr_render.work.progress import Item, Progress


class Counted(Progress):
    """Counts the refits, and ends the job after some of them, as Ctrl-C does."""

    def __init__(self, most: int = 1000) -> None:
        self.most, self.done = most, 0

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        for item in items:
            if self.done == self.most:
                raise KeyboardInterrupt
            self.done += 1
            yield item


@pytest.mark.slow
def test_an_interrupted_validation_makes_each_refit_once(
    flat_image_headset: Eye, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validate, "as_finished", in_this_process)
    monkeypatch.setattr(validation, "_REFITS", 4)  # to noise, and without a quarter; each of six bands is left out
    whole = wlr.simulate(flat_image_headset, 9, 0.25, 1, grid=(5, 4), stage_error_m=5e-6, stage_turn_rad=3e-5)
    seen = whole.both[1]
    captures = Captures(None, seen)
    fit = FitOptions(degree=1, see_through_degree=1)
    path = captures.save(tmp_path / "captures-right.npz")
    options = CalibrateOptions(str(path), out=tmp_path / "out", fit=fit, validate=True)
    first, second, of_others = Counted(5), Counted(), Counted(0)
    with pytest.raises(KeyboardInterrupt):
        calibrate(options, progress=first)
    report = calibrate(options, progress=second)
    assert first.done == 5
    assert second.done == 4 + 4 + 6 - 5
    assert report.verdict.startswith("The refits do not contradict the stated errors")
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = record["validation"]["right"]
    assert {(row["side"], row["method"]) for row in rows} == {
        ("see-through", method) for method in (NOISE, QUARTERS, BANDS)
    }
    assert sum(row["refits"] for row in rows) == first.done + second.done
    np.testing.assert_allclose([row["value"] for row in rows if row["method"] == NOISE], 1.0, atol=0.3)
    # Refits to other readings are others.
    replace(captures, see_through=replace(seen, sigma_arcmin=0.3 * np.ones(len(seen)))).save(path)
    with pytest.raises(KeyboardInterrupt):
        calibrate(options, progress=of_others)


def ratio(method: str, value: float, low: float, high: float, side: str = "display") -> Ratio:
    return Ratio(side, method, 12, value, low, high, 0.2)


AS_STATED = ratio(NOISE, 1.02, 0.9, 1.1)


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ([AS_STATED, ratio(BANDS, 1.1, 0.8, 1.5)], "The refits do not contradict the stated errors"),
        ([AS_STATED, ratio(BANDS, 2.0, 0.9, 4.1)], "The refits do not contradict the stated errors"),
        (
            [AS_STATED, ratio(QUARTERS, 1.5, 1.2, 1.9), ratio(BANDS, 2.0, 1.4, 2.9)],
            "Believe the cross-validation, not the stated errors: the cross-validation finds 2.00 (1.40 to 2.90) times "
            "the stated error of the display: count on 0.4' or more in place of 0.2'. Refits to noise alone find 1.02 ",
        ),
        ([ratio(NOISE, 1.6, 1.4, 1.9)], "Do not believe the stated errors of the display: even refits to noise alone"),
        ([ratio(NOISE, 0.5, 0.4, 0.6)], "Do not believe the stated errors of the display: even refits to noise alone"),
    ],
)
def test_the_first_sentence_says_which_errors_to_believe(found: list[Ratio], says: str) -> None:
    assert Validation(tuple(found), 0).sentence.startswith(says)


def test_the_ratio_that_no_refit_excludes_is_stated() -> None:
    sentence = Validation((AS_STATED, ratio(BANDS, 1.1, 0.8, 1.5)), 0).sentence
    assert "up to 1.5 times" in sentence
    assert "a drift that runs along with the positions" in sentence


def test_too_few_positions_are_refused_in_one_sentence(flat_image_headset: Eye, tmp_path: Path) -> None:
    path = wlr.simulate(flat_image_headset, 4, 0.25, 1, grid=(4, 3)).save(tmp_path / "few.npz")
    fit = FitOptions(degree=1, see_through_degree=1)
    with pytest.raises(BadInputError, match="8 camera positions or more, and the display has 4; add positions"):
        calibrate(CalibrateOptions(str(path), out=tmp_path / "out", fit=fit, validate=True))
    assert not (tmp_path / "out").exists()  # refused before the fit


def test_where_the_fit_leaves_out_too_many_positions_the_report_says_so(
    flat_image_headset: Eye, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validation, "_sound", lambda side: side.captures.capture < 7)
    whole = wlr.simulate(flat_image_headset, 9, 0.25, 1, grid=(4, 3))
    path = Captures(None, whole.both[1]).save(tmp_path / "captures-right.npz")
    fit = FitOptions(degree=1, see_through_degree=1)
    report = calibrate(CalibrateOptions(str(path), out=tmp_path / "out", fit=fit, validate=True))
    assert report.verdict.startswith("The stated errors are not validated")
    assert "the fit of the see-through has 7; add positions" in report.verdict
    assert (tmp_path / "out" / "report.html").exists()
