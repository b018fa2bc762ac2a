"""Sessions of photographs simulated: interrupted work goes on, and no folder is taken that holds something else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_photo_session import SmallSession, state_lenses

from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.simulate_photo_session import TakenPhotographs, simulate_photo_session
from wlr_render.simulation.photographs.take_photographs import BoardShot, CameraPose, take

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

PANEL_SET = "display/02"
LOST = ("see_through/pose1_02.png", "bare/pose0_03.png", f"{PANEL_SET}/001_black.png", "session.toml", "board.toml")


def test_interrupted_work_goes_on_and_ends_as_if_it_had_not_been(photo_session: SmallSession) -> None:
    folder = photo_session.folder
    before = {name: (folder / name).read_bytes() for name in LOST}
    kept = folder / PANEL_SET / "000_white.png"
    untouched = kept.stat()
    for name in LOST:
        (folder / name).unlink()
    cut = next(folder.glob(f"{PANEL_SET}/002_*.png"))
    whole = cut.read_bytes()
    cut.unlink()  # a hard link of the session that all tests copy
    cut.write_bytes(whole[:-100])
    made = simulate_photo_session(folder, photo_session.recipe)
    assert made == TakenPhotographs(4, 192 - 4, [cut])
    assert cut.read_bytes() == whole
    photo_session.edit(state_lenses)  # as the copied session was edited
    assert {name: (folder / name).read_bytes() for name in LOST} == before
    assert kept.stat().st_mtime_ns == untouched.st_mtime_ns


def test_a_finished_session_is_left_as_it_is(photo_session: SmallSession) -> None:
    made = simulate_photo_session(photo_session.folder, photo_session.recipe)
    assert made == TakenPhotographs(0, 192, [])
    assert photo_session.read().kept == 52


def test_a_session_made_in_another_way_is_refused(photo_session: SmallSession) -> None:
    recipe = photo_session.recipe
    for other in (
        replace(recipe, viewpoints=5),
        replace(recipe, pattern="gray"),
        replace(recipe, bench=replace(recipe.bench, seed=2)),
        replace(recipe, device="birdbath28"),
    ):
        with pytest.raises(
            BadInputError, match=r"other options: (\w+ was .* and is .*|.* has changed); choose another"
        ):
            simulate_photo_session(photo_session.folder, other)


def test_a_device_file_that_changed_meanwhile_is_another_device(photo_session: SmallSession, tmp_path: Path) -> None:
    text = (photo_session.folder / "device.toml").read_text(encoding="utf-8")
    (tmp_path / "device.toml").write_text(text.replace("index = 1.5", "index = 1.6"), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"belongs to other options: .*device\.toml has changed"):
        simulate_photo_session(
            photo_session.folder, replace(photo_session.recipe, device=str(tmp_path / "device.toml"))
        )


def test_a_real_session_is_never_written_into(photo_session: SmallSession) -> None:
    for name in ("simulation.toml", "finished.jsonl"):
        (photo_session.folder / name).unlink()
    before = (photo_session.folder / "session.toml").read_bytes()
    with pytest.raises(
        BadInputError, match=r"session\.toml: was written by another program or job; choose another folder"
    ):
        simulate_photo_session(photo_session.folder, photo_session.recipe)
    assert (photo_session.folder / "session.toml").read_bytes() == before


def test_what_is_not_known_is_refused_before_anything_is_written(photo_session: SmallSession, tmp_path: Path) -> None:
    for recipe, complaint in (
        (replace(photo_session.recipe, eye="left"), "has no left eye"),
        (replace(photo_session.recipe, pattern="grey"), "Unknown code 'grey'"),
        (replace(photo_session.recipe, device="birdbath29"), "Did you mean birdbath28"),
    ):
        with pytest.raises(BadInputError, match=complaint):
            simulate_photo_session(tmp_path / "new", recipe)
    assert not (tmp_path / "new" / "simulation.toml").exists()


def photographed(bench: PhotoBench, folder: Path, eye: str) -> NDArray[Any]:
    """A photograph of the board without the headset, which differs between eyes in its noise only."""
    shot = BoardShot(folder / "bare" / "board.png", bench.device_from_target[0])
    lens, sensor, at = bench.eyeball, bench.eyeball_sensor, bench.camera_at(np.zeros(3))
    assert take(CameraPose(lens, sensor, at, None, bench.board, [shot], eye=eye)) == [shot.path]
    return read_photograph(shot.path).astype(int)


def test_both_eyes_of_one_seed_have_noise_of_their_own(photo_session: SmallSession, tmp_path: Path) -> None:
    bench = photo_session.bench
    right, again, left = (
        photographed(bench, tmp_path / str(k), eye) for k, eye in enumerate(("right", "right", "left"))
    )
    assert np.array_equal(right, again)
    assert np.mean(right != left) > 0.2
    assert np.abs(right - left).mean() < 5
