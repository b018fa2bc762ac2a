"""Causes that users add, choose and know priors of: taken as stated, or refused in one sentence."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause import Role, with_priors
from wlr_render.diagnosis.causes import CAUSES, user_causes
from wlr_render.diagnosis.causes.user_causes import causes_for
from wlr_render.errors import BadInputError

DOCUMENT = Path(__file__).parents[2] / "docs" / "diagnosis.md"
GOOD = """
from dataclasses import replace
from wlr_render.diagnosis.cause import Cause, Parameter, Role, changed

CAUSES = [
    Cause(
        "lens_hood", "hood", "camera", (Parameter("turn", "deg", 0.1),), source="s", separated_by="m",
        variants={"v": changed("camera", "centre_px", lambda old, deg: old + deg)},
    )
]
"""


@pytest.fixture
def own(tmp_path: Path) -> Callable[[str], str]:
    """Text -> path of a file of causes."""

    def written(text: str) -> str:
        path = tmp_path / "own.py"
        path.write_text(text)
        return str(path)

    return written


def test_a_file_adds_its_causes_to_the_listed_ones(bench: Bench, own: Callable[[str], str]) -> None:
    causes = causes_for(bench, [own(GOOD)])
    assert list(causes) == [*CAUSES, "lens_hood"]
    moved = causes["lens_hood"].perturb(bench, np.array([0.5]))
    np.testing.assert_allclose(moved.camera.centre_px, bench.camera.centre_px + 0.5)


def test_an_installed_package_adds_its_causes(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cellar_of_ours.py").write_text(GOOD)
    monkeypatch.syspath_prepend(tmp_path)
    entry = EntryPoint("cellar", "cellar_of_ours:CAUSES", user_causes.ENTRY_POINTS)
    monkeypatch.setattr(user_causes, "entry_points", lambda group: [entry] if group == entry.group else [])
    assert "lens_hood" in causes_for(bench)
    assert "lens_hood" not in causes_for(bench, excluded=["lens_hood"])
    broken = EntryPoint("cellar", "cellar_of_ours:NONE", user_causes.ENTRY_POINTS)
    monkeypatch.setattr(user_causes, "entry_points", lambda group: [broken])
    with pytest.raises(BadInputError, match=r"entry point 'cellar' .cellar_of_ours:NONE.: cannot be loaded"):
        causes_for(bench)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("CAUSES = [", "THINGS = [", r"own.py: defines no CAUSES; add CAUSES"),
        ("CAUSES = [", "CAUSES = 3\nTHINGS = [", r"own.py: CAUSES is 3; it must be a tuple or list"),
        ("CAUSES = [", "CAUSES = ['lens']\nTHINGS = [", r"own.py: CAUSES holds 'lens', which is not a "),
        ("CAUSES = [", "1 / 0\nCAUSES = [", r"own.py: cannot be loaded .ZeroDivisionError: division by zero"),
        ("CAUSES = [", "exit(3)\nCAUSES = [", r"own.py: cannot be loaded .SystemExit: 3"),
        ("CAUSES = [", "raise GeneratorExit\nCAUSES = [", r"own.py: cannot be loaded .GeneratorExit"),
        ("CAUSES = [", "CAUSES = [(", r"own.py: cannot be loaded .SyntaxError"),
        ('"lens_hood"', '"latency"', r"own.py: there is a cause 'latency' already; choose another name"),
        ('"camera", (', '"bracket", (', r"'lens_hood' has the part 'bracket'; choose from device, camera"),
        ("0.1)", "0.0)", r"'lens_hood' has a prior_sigma of 0.0 for 'turn'"),
        ("0.1)", "0.1, Role.SHAPE)", r"'lens_hood' has no parameter with the role SIZE"),
        ('"centre_px"', '"center_px"', r"'lens_hood' fails in its variant 'v' .AttributeError"),
        ('{"v": changed', '{"v": lambda b, v: None, "w": changed', r"returns NoneType in its variant 'v'"),
        ('variants={"v"', 'variants={} and {"v"', r"'lens_hood' has no variants"),
    ],
)
def test_faulty_files_of_causes_are_refused_in_a_sentence(
    bench: Bench, own: Callable[[str], str], old: str, new: str, sentence: str
) -> None:
    assert old in GOOD
    with pytest.raises(BadInputError, match=sentence):
        causes_for(bench, [own(GOOD.replace(old, new, 1))])


def test_only_named_causes_are_left_less_the_excluded_ones(bench: Bench) -> None:
    assert set(causes_for(bench, only=["latency", "panel_bow"], excluded=["latency"])) == {"panel_bow"}


def test_priors_change_mean_and_sigma_of_the_parameters_they_name(bench: Bench) -> None:
    stated = {"combiner_dent": {"depth": (2.0, 1.0), "x": (3.0, 0.5)}, "latency": {"latency": (5.0, 2.0)}}
    causes = causes_for(replace(bench, priors=stated), only=["combiner_dent", "panel_bow"])
    depth, x, y, width = causes["combiner_dent"].parameters
    assert (depth.prior_mean, depth.prior_sigma, depth.starts) == (2.0, 1.0, (0.0,))
    assert (x.starts, x.prior_sigma, x.role) == ((3.0,), 0.5, Role.SHAPE)
    assert (y, width) == CAUSES["combiner_dent"].parameters[2:]
    assert causes["panel_bow"] is CAUSES["panel_bow"]


@pytest.mark.parametrize(
    ("priors", "sentence"),
    [
        ({"combiner_tlt": {}}, r"\[prior.combiner_tlt\]: There is no cause 'combiner_tlt'; did you mean combiner_tilt"),
        ({"lens_hood": {}}, r"choose from .*\. Load a cause of your own with --add-causes FILE\.py\."),
        ({"latency": {"delay": (0.0, 1.0)}}, r"\[prior.latency\]: there is no parameter 'delay'; choose from latency"),
        ({"headset_slip": {"moment": (9.0, 1.0)}}, "'moment' is searched for between captures; leave it out"),
        ({"see_through_plate": {"thickness": (-1.0, 1.0)}}, "the mean of 'thickness' is -1; the least is 0"),
    ],
)
def test_priors_of_what_does_not_exist_are_refused(
    priors: Mapping[str, dict[str, tuple[float, float]]], sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        with_priors(CAUSES, priors)


def test_the_documented_example_is_a_cause_and_the_list_is_complete(bench: Bench, own: Callable[[str], str]) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    example, screw = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    cause = causes_for(bench, [own(example)])["stage_squareness"]
    axes = cause.perturb(bench, np.array([1.0, 0.0])).stage.axes
    np.testing.assert_allclose(axes, [[1.0, np.tan(np.radians(1.0)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    moved = causes_for(bench, [own(screw)])["lead_screw"].perturb(bench, np.array([3.0, 4.0]))
    (effect,) = moved.effects
    turns = effect.function(np.array([[2.5, 0.0, 0.0], [3.0, 1.0, 2.0]]))
    np.testing.assert_allclose(turns, [[3.0, 0.0, 0.0, 0.0, 0.0, 0.0], [-4.0, 0.0, 0.0, 0.0, 0.0, 0.0]], atol=1e-12)
    listed = [
        (each.name, ", ".join(f"`{p.name}`: {p.unit} ({p.prior_sigma:g})" for p in each.parameters))
        for each in CAUSES.values()
    ]
    assert re.findall(r"^\| `(\w+)` \| (`\w+`: \S+ \(.*) \|$", text, re.MULTILINE) == listed
    assert [*CAUSES] == [name for name, _ in listed]


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ('changed("camera", "focal_px", lambda old, s: old * float(s[0]))', "camera.focal_px"),
        ('changed("camera", "focal_px", lambda old, s: old * (1.002 + 0.01 * float(s[0])))', "camera.focal_px"),
        ("lambda bench, s: replace(bench, wavelengths_um=(0.68, 0.55, 0.45))", "wavelengths_um"),
        ("lambda bench, s: replace(bench, target_wavelength_um=0.6 + float(s[0]))", "target_wavelength_um"),
        ("lambda bench, s: replace(bench, device=replace(bench.device, eyes={'right': other(bench)}))", "device"),
        ("in_place", "stage.backlash"),
    ],
)
def test_a_cause_whose_null_values_change_the_bench_is_refused(
    bench: Bench, own: Callable[[str], str], change: str, where: str
) -> None:
    given = replace(bench, stage=replace(bench.stage, backlash=np.zeros(2)))
    text = GOOD.replace('changed("camera", "centre_px", lambda old, deg: old + deg)', change).replace(
        "CAUSES = [", f"{HELPERS}\n\nCAUSES = ["
    )
    sentence = rf"'lens_hood' changes {where} in its variant 'v' at its null values \[0.0\]; there it must return"
    with pytest.raises(BadInputError, match=sentence):
        causes_for(given, [own(text)])


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        ("np.sign(np.sin(20.0 * t)) * s[0] * [1.0, 0.0]", r"cannot state \(its polynomial misses it by \d+ %\)"),
        ("(0.1 + s[0] * t) * [1.0, 0.0]", r"changes effects in its variant 'v' at its null values"),
        ("s[0] * t", r"returns shape \(2, 1\) for 2 places; it must return \(2, 2\)"),
    ],
)
def test_an_effect_that_no_file_can_state_or_that_never_vanishes_is_refused(
    bench: Bench, own: Callable[[str], str], function: str, sentence: str
) -> None:
    change = (
        "lambda bench, s: replace(bench, effects=(BenchEffect.of_function('time', 'shift', lambda t: F, [0], [9]),))"
    )
    text = "import numpy as np\nfrom wlr_render.files import BenchEffect\n" + GOOD.replace(
        'changed("camera", "centre_px", lambda old, deg: old + deg)', change.replace("F", function)
    )
    with pytest.raises(BadInputError, match=sentence):
        causes_for(bench, [own(text)])


HELPERS = """
def other(bench):
    return bench.optics.with_media(lambda medium: medium.shifted(0.001))


def in_place(bench, values):
    bench.stage.backlash[0] += 1e-3
    return bench
"""


def test_a_cause_that_fails_at_some_values_refuses_these(bench: Bench, own: Callable[[str], str]) -> None:
    """A fit then takes a shorter step, as with a headset that cannot be traced."""
    text = GOOD.replace("lambda old, deg: old + deg", "lambda old, deg: old + [10, 20][int(deg[0])] * deg")
    cause = causes_for(bench, [own(text)])["lens_hood"]
    with pytest.raises(BadInputError, match=r"cause 'lens_hood' fails in its variant 'v' .IndexError"):
        cause.perturb(bench, np.array([2.0]))
