"""Which picture each file of a code set shows, and exposures that are merged."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from wlr_render.captures.code_files import CodeFiles, find_code_files
from wlr_render.captures.decoded import Decoded, DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import write_photograph
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

PATTERN = make_pattern("gray", Panel(48, 40))
NAMES = PATTERN.names()
KIND = PhotographFormat(8)


def shown(number: int) -> NDArray[np.uint8]:
    return PATTERN.image(number) // 2 + 20


def write(folder: Path, names: Sequence[Any]) -> Path:
    """One file for each picture, with these names; None leaves it away."""
    for number, name in enumerate(names):
        if name:
            write_photograph(folder / name, shown(number))
    return folder


def decoded(folder: Path, kind: PhotographFormat = KIND, **how: Any) -> tuple[CodeFiles, Decoded]:
    files = find_code_files(folder, NAMES, **how)
    options = DecodeOptions(kind.full_scale, end_of_scale=files.end_of_scale(kind))
    return files, PATTERN.decode(files.read(kind), options)


def assert_right(result: Decoded) -> None:
    assert result.accepted.mean() > 0.95
    assert np.nanmax(np.abs(result.pixel - PATTERN.panel.pixel_centres())) < 0.01


@pytest.mark.parametrize("gap", [None, 0, 4, 9])
def test_names_of_the_page_that_shows_them_say_it_in_any_order(tmp_path: Path, gap: int | None) -> None:
    names: list[str | None] = [f"{900 - n:03d}_{name.replace(' ', '_')}.png" for n, name in enumerate(NAMES)]
    if gap is not None:
        names[gap] = None
    files, result = decoded(write(tmp_path, names))
    assert files.missing == ([] if gap is None else [gap])
    assert_right(result)


def test_a_gap_in_the_numbers_is_the_missing_picture(tmp_path: Path) -> None:
    names = [f"IMG_{n + 17:04d}.png" for n in range(len(NAMES))]
    files, result = decoded(write(tmp_path, [*names[:7], None, *names[8:]]))
    assert files.missing == [7]
    assert_right(result)


@pytest.mark.parametrize("gaps", [(0,), (-1,), (0, 4)])
def test_a_set_without_its_first_or_last_number_may_be_any_other(tmp_path: Path, gaps: tuple[int, ...]) -> None:
    names: list[str | None] = [f"{n}.png" for n in range(len(NAMES))]
    for gap in gaps:
        names[gap] = None
    with pytest.raises(BadInputError, match=r"but the code has 26 pictures.*manifest\.toml"):
        decoded(write(tmp_path, names))


def test_the_order_of_opencv(tmp_path: Path) -> None:
    names = [f"{(n - 2) % len(NAMES)}.png" for n in range(len(NAMES))]
    assert_right(decoded(write(tmp_path, names), order="opencv")[1])
    (tmp_path / "manifest.toml").write_text('order = "opencv"\n')
    assert_right(decoded(tmp_path)[1])


def test_a_manifest_gives_any_file_its_role(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    names = [f"shot{n}.png" for n in rng.permutation(len(NAMES))]
    write(tmp_path, names)
    write_photograph(tmp_path / "lamp.png", shown(0))
    said = [role.replace("u ", "Column_").replace("v ", "y ") for role in NAMES]
    rows = [f'"{name}" = "{role}"' for name, role in zip(names, said, strict=True)]
    (tmp_path / "manifest.toml").write_text("\n".join(["[files]", '"lamp.png" = "unused"', *rows]))
    assert_right(decoded(tmp_path)[1])
    roles = "\n".join(f'"{name}" = "{role}"' for name, role in zip(names, NAMES, strict=True) if role != "v bit 3")
    (tmp_path / "elsewhere.toml").write_text(f"[files]\n{roles}\n")
    files, result = decoded(tmp_path, manifest=tmp_path / "elsewhere.toml")
    assert files.missing == [NAMES.index("v bit 3")]
    assert_right(result)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[files]\n"0.png" = "u bit 99"', "0.png has the role 'u bit 99'; the code has white, black, u bit 5"),
        ('[files]\n"a.png" = "white"', "there is no .*a.png; correct its name"),
        (f'[files]\n"{"9" * 400}.png" = "white"', "there is no .*999.png; correct its name"),
        ('[files]\n"0.png" = "white"\n"1.png" = "black"\n"2.png" = "black"', "2 files have the role 'black'"),
        ('order = "sideways"', "must be one of as shown, opencv"),
        ("[exposures_s]\nshort = 0", "above 0"),
        ("[exposures_s]\nshort = true", "above 0"),
        ("[exposures_s]\nshort = inf", "above 0"),
        ('[files]\n"../a.png" = "white"', r"manifest.toml: '../a.png' leads out of the folder"),
    ],
)
def test_manifests_that_cannot_be_right(tmp_path: Path, text: str, sentence: str) -> None:
    write(tmp_path, [f"{n}.png" for n in range(len(NAMES))])
    (tmp_path / "manifest.toml").write_text(text)
    with pytest.raises(BadInputError, match=sentence):
        decoded(tmp_path)


def test_exposures_are_merged_so_that_dark_and_bright_parts_decode(tmp_path: Path) -> None:
    pattern = make_pattern("gray", Panel(240, 30))
    height, width = pattern.image(0).shape
    vignetting = np.geomspace(1.0, 0.01, width) * np.ones((height, 1))
    rng = np.random.default_rng(2)
    for seconds, name in ((0.001, "1ms"), (0.008, "8ms"), (0.064, "64ms")):
        for number, label in enumerate(pattern.names()):
            light = 200e3 * vignetting * pattern.image(number) / 255 * seconds
            grey = np.clip(np.round(light + 6 + rng.normal(0, 0.6, light.shape)), 0, 255).astype(np.uint8)
            write_photograph(tmp_path / name / f"{number:03d}_{label.replace(' ', '_')}.png", grey)
    shares = {}
    for folder in (tmp_path, tmp_path / "8ms"):
        files = find_code_files(folder, pattern.names())
        result = pattern.decode(files.read(KIND), DecodeOptions(255, end_of_scale=files.end_of_scale(KIND)))
        off = (result.pixel - pattern.panel.pixel_centres())[result.accepted]
        assert np.abs(off).max() < 0.5
        shares[folder.name] = result.accepted.mean()
    assert sorted(find_code_files(tmp_path, pattern.names()).exposures_s) == [0.001, 0.008, 0.064]
    assert shares[tmp_path.name] > 0.9 > 0.7 > shares["8ms"]
    taken = [(path.relative_to(tmp_path), path.stem[4:].replace("_", " ")) for path in tmp_path.glob("*/*.png")]
    times = [f'"{path}" = {path.parent.name[:-2]}e-3' for path, _ in taken]
    roles = [f'"{path}" = "{label}"' for path, label in taken]
    (tmp_path / "manifest.toml").write_text("\n".join(["[files]", *roles, "[exposures_s]", *times]))
    files = find_code_files(tmp_path, pattern.names())
    assert files.exposures_s == (0.001, 0.008, 0.064)
    assert all([path.parent.name for path in paths] == ["1ms", "8ms", "64ms"] for paths in files.pictures)


def test_exposures_without_a_time_are_refused(tmp_path: Path) -> None:
    for name in ("short", "long"):
        write(tmp_path / name, [f"{n}.png" for n in range(len(NAMES))])
    with pytest.raises(BadInputError, match="its exposure time is unknown"):
        decoded(tmp_path)
    (tmp_path / "manifest.toml").write_text("[exposures_s]\nshort = 0.001\nlong = 0.001\n")
    assert_right(decoded(tmp_path)[1])


def test_automatic_exposure_within_a_set_is_named(tmp_path: Path) -> None:
    for number in range(len(NAMES)):
        image = Image.fromarray(shown(number))
        tags = image.getexif()
        tags[0x829A] = 0.01 if number != 5 else 0.02
        image.save(tmp_path / f"{number}.tiff", exif=tags)
    assert cv2.imread(str(tmp_path / "5.tiff"), -1) is not None
    with pytest.raises(BadInputError, match=r"5\.tiff 0\.02 s; .* automatic exposure off"):
        decoded(tmp_path)


def test_names_of_another_code_are_refused_though_there_are_as_many(tmp_path: Path) -> None:
    names: list[str | None] = [
        f"{n:03}_{each.replace(' ', '_')}.png"
        for n, each in enumerate(make_pattern("gray-fringes", Panel(48, 40)).names())
    ]
    names += [None] * (len(NAMES) - len(names))
    with pytest.raises(
        BadInputError, match=r"_0\.png: shows 'u fringe 16 px step 0', .* the code gray-fringes: choose it"
    ):
        find_code_files(write(tmp_path, names[: len(NAMES)]), NAMES)


def test_names_of_another_panel_are_refused(tmp_path: Path) -> None:
    larger = make_pattern("gray", Panel(96, 40))
    names = [f"{n:03}_{each.replace(' ', '_')}.png" for n, each in enumerate(larger.names()[: len(NAMES)])]
    with pytest.raises(BadInputError, match=r"shows 'u bit 6', .* with the size of the panel that showed it"):
        find_code_files(write(tmp_path, names), NAMES)


def test_a_file_that_shows_no_picture_among_named_ones_is_refused(tmp_path: Path) -> None:
    """Also if another one is missing, so that their number is right."""
    names = [f"{n:03}_{each.replace(' ', '_')}.png" for n, each in enumerate(NAMES)]
    names[5] = "thumbnail.png"
    with pytest.raises(BadInputError, match=r"thumbnail\.png: its name states no picture of the code"):
        find_code_files(write(tmp_path, names), NAMES)
