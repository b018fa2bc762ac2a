"""Calling the command line in tests."""

from wlr_render.cli import main


def refused(arguments, capsys):
    """The one line in which a command says no."""
    status = main(arguments)
    printed = capsys.readouterr()
    assert status == 2
    lines = printed.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("wlr-render: ")
    assert "Traceback" not in printed.out + printed.err
    return lines[0]
