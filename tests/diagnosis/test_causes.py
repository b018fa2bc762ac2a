"""What every cause promises, whatever it is: nothing at null, its own part of the bench only, smooth and additive."""

import pathlib
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import run_time_plan
from numpy.typing import NDArray
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import SeeThroughPlan, SessionPlan, select_rows
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.assembly import ASSEMBLY_ERRORS, AssemblyError, assembled
from wlr_render.optics.device import Path, mirrored
from wlr_render.optics.device_file import load_device, save_device
from wlr_render.optics.tracer import trace

PARTS = {"device", "camera", "stage", "target", "tracking", "mount", "eye tracking", "clock"}
RUN_TIME = {"eye tracking", "clock"}
# How the picture is read out is a part of the device that is not in its prescription.
READ_OUT = {"lateral_colour": "readout", "pixel_origin": "readout", "pixel_origin of the camera": "camera"}
IN_SEE_THROUGH_ONLY = {"see_through_plate", "substrate_index"}  # a mirror's substrate is not met by the display's light
MOMENT_S = 1300.0  # during the see-through captures

WAYS = [(cause, variant) for cause in CAUSES.values() for variant in cause.variants]
IDS = [f"{cause.name} {variant}" for cause, variant in WAYS]
DEVICE_WAYS = [(c, v) for c, v in WAYS if c.part == "device" and c.name not in READ_OUT]
DEVICE_IDS = [f"{cause.name} {variant}" for cause, variant in DEVICE_WAYS]
every_way = pytest.mark.parametrize(("cause", "variant"), WAYS, ids=IDS)
every_device_way = pytest.mark.parametrize(("cause", "variant"), DEVICE_WAYS, ids=DEVICE_IDS)


def sized(cause: Cause, share: float) -> FloatArray:
    """Values at a share of the prior sigmas; forms at their first start."""
    kinds: dict[Role, Callable[[Parameter], float]] = {
        Role.SIZE: lambda p: share * p.prior_sigma,
        Role.SHAPE: lambda p: p.starts[0],
        Role.TIME: lambda p: MOMENT_S,
    }
    return np.array([kinds[parameter.role](parameter) for parameter in cause.parameters])


@pytest.fixture(scope="module")
def plans(bench: Bench, plan: SessionPlan) -> dict[bool, SessionPlan]:
    """A thinned plan for causes on the bench, and one for causes at run time."""
    shown, seen = present(plan.display), present(plan.see_through)
    few = SessionPlan(
        select_rows(shown, np.arange(0, len(shown), 9)),
        select_rows(seen, np.arange(0, len(seen), 9)),
    )
    return {False: few, True: SessionPlan(run_time=run_time_plan(bench, 40))}


@pytest.fixture(scope="module")
def read(plans: Mapping[bool, SessionPlan]) -> Callable[[Bench, Cause], FloatArray]:
    """(bench, cause) -> what it reads where the cause can be seen, in one list, camera or panel pixels."""

    def all_readings(bench: Bench, cause: Cause) -> FloatArray:
        found = simulate(bench, plans[cause.part in RUN_TIME])
        own = [
            found.panel_pixel,
            found.dot_pixel,
            None if found.run_time_pixel is None else found.run_time_pixel.reshape(-1, 2),
        ]
        return np.concatenate([part for part in own if part is not None])

    return all_readings


@pytest.mark.parametrize("cause", CAUSES.values(), ids=CAUSES)
def test_a_cause_says_what_it_is(cause: Cause) -> None:
    assert cause.part in PARTS
    for text in (cause.title, cause.source, cause.separated_by, *cause.variants):
        assert text
    names = [parameter.name for parameter in cause.parameters]
    assert len(set(names)) == len(names) > 0
    for parameter in cause.parameters:
        assert parameter.unit
        assert 0 < parameter.prior_sigma < np.inf
        if parameter.role is Role.SIZE:
            assert parameter.starts == (0.0,)
    assert any(parameter.role is Role.SIZE for parameter in cause.parameters)


@every_way
def test_null_values_change_no_reading(bench: Bench, read: Callable[..., Any], cause: Cause, variant: str) -> None:
    np.testing.assert_allclose(read(cause.perturb(bench, cause.null(), variant), cause), read(bench, cause), atol=1e-9)


@every_way
def test_a_cause_changes_its_own_part_of_the_bench_only(bench: Bench, cause: Cause, variant: str) -> None:
    changed = cause.perturb(bench, sized(cause, 1.0), variant)
    different = {
        field.name for field in fields(bench) if getattr(changed, field.name) is not getattr(bench, field.name)
    }
    own = READ_OUT.get(f"{cause.name} {variant}", READ_OUT.get(cause.name, cause.part.replace(" ", "_")))
    assert different == {own}


@every_way
def test_a_small_effect_is_proportional_adds_to_itself_and_is_undone(
    bench: Bench, read: Callable[..., Any], cause: Cause, variant: str
) -> None:
    at_rest = read(bench, cause)
    half, whole = sized(cause, 0.05), sized(cause, 0.1)
    once = cause.perturb(bench, half, variant)
    effect = read(cause.perturb(bench, whole, variant), cause) - at_rest
    size = np.abs(effect).max()
    assert size > 1e-3
    np.testing.assert_allclose(2 * (read(once, cause) - at_rest), effect, atol=0.01 * size)
    np.testing.assert_allclose(read(cause.perturb(once, half, variant), cause) - at_rest, effect, atol=1e-3 * size)
    back = cause.perturb(once, sized(cause, -0.05), variant)
    # A plate of negative thickness undoes another one near the axis only.
    np.testing.assert_allclose(
        read(back, cause), at_rest, atol=(0.1 if cause.name == "see_through_plate" else 1e-3) * size
    )


@every_device_way
def test_only_what_a_device_cause_names_is_moved(bench: Bench, cause: Cause, variant: str) -> None:
    device = load_device("northstar")
    both = replace(bench, device=device)
    changed = cause.perturb(both, sized(cause, 1.0), variant)
    assert (changed.device.eyes["left"] is device.eyes["left"]) != (cause.name == "frame_bend")
    assert changed.device.name == device.name
    new, old = changed.optics, both.optics
    assert new.eye_box is old.eye_box
    assert (new.panel is old.panel) != cause.name.startswith(("panel", "frame"))
    if cause.name.startswith("panel"):
        assert new.display is old.display
        assert new.see_through is old.see_through
    if cause.name.startswith("combiner"):
        moved = {s.name: s.device_from_surface for s in new.surfaces()}
        rigid_moves = [moved[s.name] @ s.surface_from_device for s in old.surfaces()]
        assert len(rigid_moves) == 2
        np.testing.assert_allclose(rigid_moves[0], rigid_moves[1], atol=1e-15)


def test_a_bent_frame_turns_both_eyes_as_mirror_images_and_each_as_a_whole(bench: Bench) -> None:
    """Toe-in is symmetric, twist antisymmetric: with the twist reversed, one eye is the other's mirror image."""
    both = replace(bench, device=load_device("northstar"))
    bent, twisted_back = (
        CAUSES["frame_bend"].perturb(both, np.array([0.4, twist])).device.eyes for twist in (0.2, -0.2)
    )
    mirror = mirrored(twisted_back["left"])
    for one, other in zip(bent["right"].surfaces(), mirror.surfaces(), strict=True):
        np.testing.assert_allclose(one.device_from_surface, other.device_from_surface, atol=1e-12)
    np.testing.assert_allclose(bent["right"].panel.device_from_panel, mirror.panel.device_from_panel, atol=1e-12)
    between = np.append(both.optics.eye_box.centre * [0.0, 1.0, 1.0], 1.0)
    for side, inward in (("right", -1.0), ("left", 1.0)):
        old, new = both.device.eyes[side], bent[side]
        moves = [new.panel.device_from_panel @ old.panel.panel_from_device]
        moves += [
            b.device_from_surface @ a.surface_from_device for a, b in zip(old.surfaces(), new.surfaces(), strict=True)
        ]
        for move in moves:
            np.testing.assert_allclose(move, moves[0], atol=1e-12)
        np.testing.assert_allclose(moves[0] @ between, between, atol=1e-15)
        ahead = moves[0][:3, :3] @ [0.0, 0.0, -1.0]
        np.testing.assert_allclose(np.rad2deg(ahead[:2]), [0.4 * inward, 0.2 * -inward], atol=1e-4)


@pytest.mark.parametrize("device", ["northstar", "birdbath28", "plane_plate"])
@pytest.mark.parametrize("variant", CAUSES["substrate_thickness"].variants)
def test_a_thicker_combiner_has_a_longer_way_through_it(bench: Bench, device: str, variant: str) -> None:
    def way(of: Bench) -> float:
        start, ahead = of.optics.eye_box.centre, np.array([0.0, -0.1, -1.0]) / np.sqrt(1.01)
        steps = of.optics.see_through.steps
        near, far = (trace(Path(met), start, ahead, 0.55).origin for met in (steps[:1], steps))
        return float(np.linalg.norm(far - near))

    loaded = replace(bench, device=load_device(device))
    thicker = way(CAUSES["substrate_thickness"].perturb(loaded, np.array([0.1]), variant)) - way(loaded)
    # Less along the axis of Project North Star's ellipsoid, which lies 53 degrees off the face's normal.
    assert 0.5e-4 < thicker < 3e-4


@pytest.mark.parametrize("name", sorted(IN_SEE_THROUGH_ONLY))
def test_what_lies_behind_the_mirror_leaves_the_picture_alone(
    bench: Bench, plans: dict[bool, SessionPlan], name: str
) -> None:
    cause = CAUSES[name]
    shown = SessionPlan(display=plans[False].display)
    before, after = (simulate(b, shown).panel_pixel for b in (bench, cause.perturb(bench, sized(cause, 1.0))))
    np.testing.assert_array_equal(before, after)


@every_device_way
def test_a_perturbed_device_is_saved_and_loaded_with_the_same_readings(
    tmp_path: pathlib.Path, bench: Bench, read: Callable[[Bench, Cause], FloatArray], cause: Cause, variant: str
) -> None:
    changed = cause.perturb(bench, sized(cause, 0.7), variant)
    loaded = replace(changed, device=load_device(str(save_device(changed.device, tmp_path / "device.toml"))))
    np.testing.assert_allclose(read(loaded, cause), read(changed, cause), atol=1e-7)


@pytest.mark.parametrize("device", ["birdbath28", "freeform40", "prism5701202", "plane_plate"])
def test_thickened_twice_tilted_and_behind_a_plate_any_device_survives_its_file(
    tmp_path: pathlib.Path, bench: Bench, plans: dict[bool, SessionPlan], device: str
) -> None:
    """An offset of an offset, a wedge, and surfaces of every shape."""
    loaded = load_device(device)
    middle = loaded.eyes["right"].eye_box.centre
    changed = replace(bench, device=loaded, stage=replace(bench.stage, origin=middle))
    changed = replace(changed, camera=replace(bench.camera, pupil_offset=middle - bench.stage.origin))
    for name, values, variant in (
        ("substrate_thickness", [0.1], "its outer face moves along its normals"),
        ("substrate_thickness", [0.07], "its inner face moves along its normals"),
        ("substrate_thickness", [-0.03], "its outer face moves along its normals"),
        ("combiner_tilt", [0.3, -0.2, 0.4], None),
        ("see_through_plate", [5.0, 3.0, -2.0], "facing the eye, a wedge of the angles"),
        ("see_through_plate", [3.0, 13.0, -12.0], "plane-parallel, tilted by the angles"),
    ):
        changed = CAUSES[name].perturb(changed, np.array(values), variant)
    again = replace(changed, device=load_device(str(save_device(changed.device, tmp_path / "device.toml"))))
    first, second = simulate(changed, plans[False]), simulate(again, plans[False])
    assert first.panel_pixel is not None
    assert np.isfinite(first.panel_pixel).mean() > 0.3
    assert first.dot_pixel is not None
    assert np.isfinite(first.dot_pixel).mean() > 0.3
    np.testing.assert_allclose(present(second.panel_pixel), first.panel_pixel, atol=1e-6)
    np.testing.assert_allclose(present(second.dot_pixel), first.dot_pixel, atol=1e-6)


@pytest.mark.parametrize("thickness_mm", [4.0, -4.0])
def test_an_added_plate_moves_dots_as_the_textbook_says(bench: Bench, thickness_mm: float) -> None:
    """t (1 - 1 / n) nearer near the axis; a negative thickness is its mirror image."""
    open_bench = replace(
        bench,
        device=load_device("no_optics"),
        stage=replace(bench.stage, origin=np.zeros(3)),
        target=replace(bench.target, device_from_target=np.array([np.diag([1.0, 1.0, 1.0, 1.0])]), pitch=np.ones(1)),
    )
    open_bench.target.device_from_target[0, 2, 3] = -0.5
    plated = CAUSES["see_through_plate"].perturb(open_bench, np.array([thickness_mm, 0.0, 0.0]))
    dot = np.array([[0.02, 0.0], [0.0, -0.015], [0.01, 0.01]])
    plan = see_through_at_middle(dot)
    index = 1.4917  # of PMMA in green light
    nearer = 1e-3 * thickness_mm * (1 - 1 / index)
    camera = bench.camera
    expected = camera.centre_px + camera.focal_px * [1, -1] * dot / (0.5 - nearer)
    np.testing.assert_allclose(present(simulate(plated, plan).dot_pixel), expected, atol=3e-3)
    tilted = CAUSES["see_through_plate"].perturb(open_bench, np.array([thickness_mm, 0.0, 10.0]))
    moved = present(simulate(tilted, plan).dot_pixel) - present(simulate(plated, plan).dot_pixel)
    # Turned left by 10 degrees, the plate shifts the ray by t sin a (1 - cos a / sqrt(n^2 - sin^2 a)) in x.
    a = np.deg2rad(10.0)
    shift = 1e-3 * thickness_mm * np.sin(a) * (1 - np.cos(a) / np.sqrt(index**2 - np.sin(a) ** 2))
    np.testing.assert_allclose(np.abs(moved[:, 0]), abs(camera.focal_px[0] * shift / 0.5), rtol=0.1)


def see_through_at_middle(dot: NDArray[Any]) -> SessionPlan:
    count = len(dot)
    zeros = np.zeros(count)
    whole = zeros.astype(int)
    return SessionPlan(see_through=SeeThroughPlan(whole, zeros, zeros + 1, np.zeros((count, 3)), whole, dot))


@pytest.mark.parametrize("error", ASSEMBLY_ERRORS, ids=lambda error: error.name)
def test_the_fit_of_a_prescription_moves_the_same_parts_by_the_same_plausible_sizes(
    bench: Bench, error: AssemblyError
) -> None:
    names = {"panel_shift": ("panel_shift", "panel_axial_shift")}.get(error.name, (error.name,))
    sizes = [parameter.prior_sigma for name in names for parameter in CAUSES[name].parameters]
    np.testing.assert_array_equal(sizes, error.plausible_size)
    values = np.zeros((len(ASSEMBLY_ERRORS), 3))
    values[ASSEMBLY_ERRORS.index(error)] = sizes
    fitted, moved, left = assembled(bench.optics, values.ravel()), bench, sizes
    for name in names:
        count = len(CAUSES[name].parameters)
        moved, left = CAUSES[name].perturb(moved, np.array(left[:count])), left[count:]
    for one, other in zip(fitted.surfaces(), moved.optics.surfaces(), strict=True):
        np.testing.assert_allclose(one.device_from_surface, other.device_from_surface, atol=1e-12)
    np.testing.assert_allclose(fitted.panel.device_from_panel, moved.optics.panel.device_from_panel, atol=1e-12)
    assert not np.allclose(fitted.panel.device_from_panel, bench.optics.panel.device_from_panel) or not np.allclose(
        fitted.surfaces()[0].device_from_surface, bench.optics.surfaces()[0].device_from_surface
    )
