"""What a compositor costs its host: what it makes is counted, what others make is not."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from speed_work import needs_gl, small_work

from benchmarks.speed import host
from benchmarks.speed.workload import bench_scene
from wlr_render.compositing.compositor import Compositor
from wlr_render.errors import BadInputError


@pytest.mark.slow
@pytest.mark.gl
def test_memory_is_of_what_the_compositor_makes(small_panel_model, monkeypatch):
    needs_gl()
    work = small_work(small_panel_model)
    found, kept = host.eye_bytes(work, "auto"), []
    assert found > 0
    assert host.eye_bytes(replace(work, scene=bench_scene(8000)), "auto") == found
    compose = Compositor.compose

    def with_a_texture(self, *given):
        with self.context.drawing():
            kept.append(self.context.target((100, 50), 4, "f4"))
        return compose(self, *given)

    monkeypatch.setattr(Compositor, "compose", with_a_texture)
    assert host.eye_bytes(work, "auto") == found + 100 * 50 * 16


def test_figures_of_a_submission_are_medians_of_the_turns(small_panel_model, monkeypatch):
    times = iter([1.0, 0.5, 2.0, 0.4, 1.0, 0.9, 1.0, 0.5, 1.0, 0.5])

    def measured(models, size, way, frames):
        return SimpleNamespace(frame_ms=next(times), calls=600 if way == "kept" else 151, gets=0)

    monkeypatch.setattr(host, "measure", measured)
    time, calls = host.submission(small_work(small_panel_model)).figures
    assert (time.ours, time.compared_with[:4], time.is_reached) == ("0.5 ms", "1 ms", True)
    assert time.ratio.startswith("0.50 +- ")
    assert (calls.ours, calls.is_reached) == ("151 / 0", False)


def test_a_machine_that_cannot_count_calls_says_so(small_panel_model, monkeypatch):
    def refused(*given):
        raise BadInputError("no x86-64")

    monkeypatch.setattr(host, "measure", refused)
    (figure,) = host.submission(small_work(small_panel_model)).figures
    assert figure.ours == "not measured: no x86-64"
