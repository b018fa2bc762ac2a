import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from streamed import BOX, RATE_HZ, fixations, recorded

from benchmarks.soak import study
from benchmarks.soak.records import Stream
from benchmarks.soak.study import SoakOptions
from benchmarks.soak.wearer import Wearer
from wlr_render.errors import MissingGlError
from wlr_render.jobs.headset import open_eye
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult, Status
from wlr_render.numerics.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class FailsLeftWhenFarRight:
    """A display whose solve fails in the panel's left third while the pupil is 2.5 to 3.5 mm right of the centre."""

    whole: DisplayMapping

    @property
    def panel(self) -> Panel:
        return self.whole.panel

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        assert warm_start is None or np.isfinite(warm_start).all()
        good = self.whole.view_dir_of_pixel(pixel, viewpoint)
        x_mm = 1e3 * (np.asarray(viewpoint)[..., 0] - BOX.centre[0])
        failed = (np.asarray(pixel)[..., 0] < self.panel.width_px / 3) & (x_mm > 2.5) & (x_mm < 3.5)
        status = np.where(failed, np.uint8(Status.NOT_CONVERGED), good.status)
        return QueryResult(np.where(failed[..., None], np.nan, good.value), status)

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        return self.whole.pixel_of_view_dir(view_dir, viewpoint, warm_start)


def options(scene_file: str, wearer: Wearer, frames: int, **others: Any) -> SoakOptions:
    wears: dict[str, Any] = {"head": wearer.head, "eye_track": wearer.eyes, "seed": wearer.seed}
    return study.SoakOptions(
        "headset", scene_file, **wears, frames=frames, frames_per_second=RATE_HZ, size=(56, 40), **others
    )


def streamed(chosen: SoakOptions, models: Mapping[str, Eye]) -> Stream:
    try:
        return study.draw(chosen, models)
    except MissingGlError as error:
        pytest.skip(str(error))


@pytest.mark.gl
def test_after_a_jump_the_frames_own_map_is_right_and_the_one_before_is_not(
    flat_image_headset: Eye, scene_file: str, tmp_path: Path
) -> None:
    wearer = recorded(tmp_path / "eyes.txt", fixations([-3, 0, 1], [3, 2, -1], [0, -3, 0]))
    stream = streamed(options(scene_file, wearer, 12), {"right": flat_image_headset})
    jumped = [check for check in stream.checks if check.moved_mm > 1.0]
    assert [round(check.time_s, 3) for check in jumped] == [0.04, 0.08]
    for check in stream.checks:
        assert check.own_arcmin < 0.01
        assert check.one_sided == 0
        # The picture is 2 m away: a move of 1 mm across turns every ray by some 1.7'.
        assert (check.kept_arcmin > 1.0) == (check.moved_mm > 1.0)


@pytest.mark.gl
def test_points_that_fail_are_named_with_time_and_eye_and_are_whole_again_next_frame(
    flat_image_headset: Eye, scene_file: str, tmp_path: Path
) -> None:
    failing = dataclasses.replace(flat_image_headset, display=FailsLeftWhenFarRight(flat_image_headset.display))
    wearer = recorded(tmp_path / "eyes.txt", fixations([0, 0, 0], [3, 0, 0], [0, 0, 0], each=3))
    stream = streamed(options(scene_file, wearer, 9), {"right": failing})
    assert [(round(frame.moment.time_s, 3), eye) for frame, eye in stream.dropped()] == [
        (0.03, "right"),
        (0.04, "right"),
        (0.05, "right"),
    ]
    for frame, _ in stream.dropped():
        assert frame.unsolved["right"].keys() == {"not converged"}
    assert all(not frame.unsolved["right"] for k, frame in enumerate(stream.frames) if k not in (3, 4, 5))


def test_both_eyes_of_a_late_head_are_drawn_and_each_is_noted(straight_device: str, scene_file: str) -> None:
    models = {eye: open_eye(straight_device, eye) for eye in ("left", "right")}
    stream = study.draw(options(scene_file, Wearer(), 4, late_ms=20.0), models)
    assert stream.eyes == ("left", "right")
    for frame in stream.frames:
        assert frame.unsolved.keys() == frame.moment.eyes.keys() == {"left", "right"}
        assert min(frame.cost.draw_ms, frame.cost.compose_ms, frame.cost.cpu_ms, frame.cost.resident_mb) > 0
    assert len(stream.checks) == 2 * len({check.time_s for check in stream.checks})
