"""The speed benchmark as a whole: what it refuses before it measures."""

from pathlib import Path
from typing import NoReturn

import pytest

from benchmarks.speed import study
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl import gl


def test_a_run_without_opengl_cannot_be_recorded_and_nothing_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "workload", lambda *given: pytest.fail("it measures first"))
    with pytest.raises(BadInputError, match="OpenGL does not open here; leave --record out"):
        study.run(study.SpeedOptions(backend="cpu", out=tmp_path / "out", record=tmp_path / "kept"))
    assert not (tmp_path / "kept").exists()


def test_only_opengl_that_is_asked_for_by_name_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(backend: object) -> NoReturn:
        raise MissingGlError("none")

    monkeypatch.setattr(gl, "open_context", missing)
    assert study._renderer("auto") is None
    assert study._renderer("cpu") is None
    with pytest.raises(MissingGlError):
        study._renderer("egl")
