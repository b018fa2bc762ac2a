"""The gallery: its commands are those of the program, and its page leads to the report of each run."""

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, needs_browser
from PIL import Image

from benchmarks.gallery import study
from benchmarks.gallery.study import GalleryOptions, Run, planned_runs, run, small_picture
from wlr_render.cli import make_app
from wlr_render.errors import BadInputError

ROOT = Path(__file__).resolve().parents[3]


def png(colour, size=(30, 20)):
    content = io.BytesIO()
    Image.new("RGBA", size, colour).save(content, "PNG")
    return content.getvalue()


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """Two runs that an earlier gallery left: one with a picture of its own, one of whose page a picture is taken."""
    runs = [
        Run("First", ["demo"], "a", picture="own.png"),
        Run("Second", ["budget", "m"], "b", "budget.html", plot=2),
    ]
    for each in runs:
        page = tmp_path / "out" / each.name / each.page
        page.parent.mkdir(parents=True)
        page.write_text("<p>page</p>")
        page.with_suffix(".json").write_text(json.dumps({"sentence": f"{each.title} <works>."}))
    (tmp_path / "out" / "a" / "own.png").write_bytes(png("red", (3000, 1000)))
    taken = []
    monkeypatch.setattr(study, "planned_runs", lambda options: runs)
    monkeypatch.setattr(study.shutil, "which", lambda name: name)
    monkeypatch.setattr(study, "_photographed", lambda *arguments: taken.append(arguments) or png("blue"))
    return taken


def test_the_page_shows_each_run_and_leads_to_its_report(finished, tmp_path):
    folder = tmp_path / "out"
    report = run(GalleryOptions(out=folder, resume=True))
    page = (folder / "index.html").read_text()
    links = re.findall(r'<a href="([^"#]+)"><img', page)
    assert links == ["a/report.html", "b/budget.html"]
    assert all((folder / link).is_file() for link in links)
    assert "First &lt;works&gt;." in page
    assert f"./wlr budget m --out {folder / 'b'}" in page
    assert finished == [("chromium", folder / "b" / "budget.html", 2)]
    assert report.files[0] == folder / "index.html"


def test_the_kept_page_has_its_pictures_and_no_links_to_what_is_not_kept(finished, tmp_path):
    run(GalleryOptions(out=tmp_path / "out", resume=True, record=tmp_path / "docs"))
    text = (tmp_path / "docs" / "gallery.md").read_text()
    pictures = re.findall(r"!\[\w+\]\((.*?)\)", text)
    assert pictures == ["gallery/a.png", "gallery/b.png"]
    assert all((tmp_path / "docs" / picture).is_file() for picture in pictures)
    assert "index.html" in text
    assert "report.html" not in text


def test_pictures_are_small():
    noise = np.random.default_rng(0).integers(0, 255, (1000, 2400, 3), np.uint8)
    content = io.BytesIO()
    Image.fromarray(noise).save(content, "PNG")
    with Image.open(io.BytesIO(small_picture(content.getvalue()))) as small:
        assert small.size == (900, 375)
        assert small.mode == "P"
    with Image.open(io.BytesIO(small_picture(png("red")))) as kept:
        assert (kept.size, kept.mode) == ((30, 20), "RGB")


def test_the_program_takes_the_commands_and_finds_the_session():
    app, options = make_app(), GalleryOptions()
    for each in planned_runs(options):
        app.parse_args(each.command(options.out), exit_on_error=False, print_error=False)
    assert any(each.words == ["diagnose", "examples/data/session"] for each in planned_runs(options))
    assert (ROOT / "examples/data/session/bench.toml").is_file()


def test_a_run_that_fails_is_named(finished, tmp_path):
    with pytest.raises(BadInputError, match=r"wlr-render budget m --out .* ended with status 2: .*m"):
        study._run(["budget", "m", "--out", str(tmp_path / "c")])


def test_without_a_browser_nothing_is_run(monkeypatch, tmp_path):
    monkeypatch.setattr(study.shutil, "which", lambda name: None)
    with pytest.raises(BadInputError, match="install chromium"):
        run(GalleryOptions(out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@needs_browser
def test_a_picture_of_a_page_begins_with_its_plot(tmp_path):
    page = tmp_path / "page.html"
    boxes = [f'<div id="plot{n}" style="height:900px;background:{c}"></div>' for n, c in ((1, "#f00"), (2, "#00f"))]
    figures = "".join(f'<h3>H</h3><figure style="margin:0">{box}</figure>' for box in boxes)
    page.write_text(f'<body style="margin:0"><header>H</header><main>{figures}</main><footer>F</footer>')
    for plot, colour in ((1, (255, 0, 0)), (2, (0, 0, 255))):
        with Image.open(io.BytesIO(study._photographed(CHROMIUM, page, plot))) as picture:
            assert picture.convert("RGB").getpixel((600, 5)) == colour
