"""Calling the command line in tests."""

from collections.abc import Sequence
from typing import Any

import pytest

from wlr_render.cli import main


def refused(arguments: Sequence[Any], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line in which a command says no."""
    status = main(arguments)
    printed = capsys.readouterr()
    assert status == 2
    lines = printed.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("wlr-render: ")
    assert "Traceback" not in printed.out + printed.err
    return lines[0]
