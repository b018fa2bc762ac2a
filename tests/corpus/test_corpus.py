"""Every case of the corpus, judged: no traceback, nothing accepted in silence, nothing left over."""

from pathlib import Path
from typing import Any

import pytest
from small_photo_session import in_this_process

from corpus.all_cases import all_cases
from corpus.case import Case
from corpus.running import verdict
from wlr_render.captures import session_reading
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.jobs import diagnose as diagnose_job

FEW = {"target_scale", "tracking_translation", "eye_position_bias"}


def diagnosed_by_few_causes(nominal: Any, session: Any, progress: Any, causes: Any, settings: Any) -> Diagnosis:
    """Diagnose by a few of the causes, and by those that a file states."""
    kept = {name: cause for name, cause in causes.items() if name in FEW or name not in CAUSES}
    return diagnose(nominal, session, progress, kept, settings)


@pytest.fixture(autouse=True)
def photographs_read_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read photographs without the worker process of --workers 1, which takes longer to start than to read them."""
    monkeypatch.setattr(session_reading, "as_finished", in_this_process)


@pytest.fixture(autouse=True)
def few_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnose_job, "diagnose_session", diagnosed_by_few_causes)


@pytest.mark.parametrize("case", all_cases(), ids=lambda case: case.name.encode("unicode_escape").decode())
def test_case(case: Case, bases: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found, outcome = verdict(bases, case, capfd.readouterr)
    assert not found, f"{'; '.join(found)}\nwlr-render {' '.join(case.arguments)}\n{outcome.out}{outcome.err}"
