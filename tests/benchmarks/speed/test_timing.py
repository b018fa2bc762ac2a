"""Runs take turns; ratios and their standard errors are those of the rounds."""

import numpy as np
import pytest

from benchmarks.speed.timing import ROUNDS, TIME_COLUMNS, GpuRun, alternately, frame_times, ratio
from wlr_render.gl.context import GlContext


def test_runs_are_timed_in_turn_and_the_first_round_is_dropped() -> None:
    calls = []
    first, second = alternately(lambda turn: calls.append(("a", turn)), lambda turn: calls.append(("b", turn)))
    assert calls[:4] == [("a", 0), ("b", 0), ("a", 1), ("b", 1)]
    assert len(calls) == 2 * (ROUNDS + 1)
    assert min(first, second) >= 0


@pytest.mark.gl
def test_runs_that_draw_have_three_times_and_the_others_no_gpu_work(gl_context: GlContext) -> None:
    calls: list[str] = []
    with gl_context.drawing():
        target = gl_context.framebuffer([gl_context.target((64, 64), 4, "f1")])

    def draw(turn: int) -> None:
        calls.append(f"draw {turn}")
        with gl_context.drawing():
            target.clear(1.0)

    on_gpu = GpuRun(draw, gl_context.drawing)
    on_cpu = GpuRun(lambda turn: calls.append(f"compute {turn}"), None)
    drawn, computed = frame_times(on_gpu, on_cpu, rounds=2)
    # As a program sees them in turns; then, on the GPU, those that draw.
    assert calls[:6] == [f"{what} {turn}" for turn in range(3) for what in ("draw", "compute")]
    assert calls[6:] == [f"draw {turn}" for turn in range(3)]
    assert drawn.gpu.shape == drawn.cpu.shape == drawn.seen.shape == (2,)
    assert (drawn.gpu > 0).all()
    assert np.isnan(computed.gpu).all()
    assert [cell is None for cell in computed.cells()] == [True, False, False]
    assert len(drawn.cells()) == len(TIME_COLUMNS)


def test_a_ratio_is_taken_round_by_round_and_one_interruption_does_not_count() -> None:
    second = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    found = ratio(second * [1.3, 1.3, 1.3, 1.3, 9.0], second)
    assert found.value == pytest.approx(1.3)
    assert found.standard_error == pytest.approx(0, abs=1e-12)
