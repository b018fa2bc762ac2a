"""Photographs that a camera's own program takes."""

import sys
from pathlib import Path

import pytest

from wlr_render.errors import BadInputError
from wlr_render.jobs.show_pattern import take_photograph


def python(code: str) -> str:
    return f'{sys.executable} -c "{code}" {{path}}'


SLOW = "import sys,time; f=open(sys.argv[1],'wb'); [(f.write(b'12345'), f.flush(), time.sleep(0.15)) for _ in range(3)]"
BEHIND = (
    "import sys,subprocess; subprocess.Popen([sys.executable,'-c',"
    "'import sys,time; time.sleep(0.4); f=open(sys.argv[1],\\'wb\\'); f.write(b\\'1\\'); f.flush(); time.sleep(0.15);"
    " f.write(b\\'2\\')',sys.argv[1]])"
)


@pytest.mark.slow
@pytest.mark.parametrize(("code", "size"), [(SLOW, 15), (BEHIND, 2)])
def test_the_file_is_complete_when_it_has_its_name(code: str, size: int, tmp_path: Path) -> None:
    """Also of a command that ends before its file is written."""
    path = tmp_path / "a b" / "000_white.png"
    path.parent.mkdir()
    take_photograph(python(code), path, 10)
    assert path.stat().st_size == size
    assert list(path.parent.iterdir()) == [path]


def test_what_an_interrupted_run_left_is_replaced(tmp_path: Path) -> None:
    (tmp_path / ".x.png").write_bytes(b"long ago and cut short")
    take_photograph(python("import sys; open(sys.argv[1], 'xb').write(b'new')"), tmp_path / "x.png", 10)
    assert (tmp_path / "x.png").read_bytes() == b"new"


@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("gphoto2 --capture", r"lacks \{path\}, the placeholder for"),
        ("gphoto2 '{path}", "is not a command \\(No closing quotation\\)"),
        ("no-such-program {path}", "`no-such-program .*x.png` cannot be run \\(No such file or directory\\)"),
        (python("import sys; print('a'); sys.exit('no camera found')"), r"failed with status 1 \(no camera found\)"),
        (python("raise SystemExit(3)"), r"failed with status 3 \(no message\)"),
        (python("pass"), r"ended, but its file was not written within 1 s; correct --photograph"),
        (python("import sys; open(sys.argv[1], 'wb')"), r"its file was not written within 1 s"),
        (python("import time; time.sleep(30)"), r"did not end within 1 s; try it by hand"),
    ],
)
def test_what_goes_wrong_is_one_sentence(command: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=complaint) as caught:
        take_photograph(command, tmp_path / "x.png", 1)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "x.png").exists()
