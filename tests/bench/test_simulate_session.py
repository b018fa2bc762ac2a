"""What a bench reads, against closed forms: straight lines, a flat mirror, a plane plate; and the parts of a bench."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.bench.bench import (
    Bench,
    EyeballCamera,
    Mount,
    PanelReadout,
    Stage,
    Target,
    Tracking,
)
from wlr_render.bench.simulate_session import (
    DotViews,
    Views,
    decoded,
    simulate,
    undecoded,
)
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, SessionPlan
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device

FOCAL, CENTRE = np.array([1000.0, 1100.0]), np.array([640.0, 512.0])
STRAIGHT = np.eye(3)
DISTANCE = 0.6
ROWS = 60


def bench_with(device: str, **parts: Any) -> Bench:
    """A bench whose target stands square to the view at `DISTANCE`, its axes along the device's."""
    loaded = load_device(device)
    middle = loaded.eyes["right"].eye_box.centre
    facing = rigid(np.eye(3), middle - [[0.0, 0.0, DISTANCE]])
    camera = EyeballCamera(np.array([1280.0, 1024.0]), FOCAL, CENTRE, 0.1)
    bench = Bench(loaded, "right", camera, Stage(middle), Target(facing, np.array([0.02])))
    return replace(bench, **parts)


def with_camera(bench: Bench, **changes: Any) -> Bench:
    return replace(bench, camera=replace(bench.camera, **changes))


def display_plan(bench: Bench, seed: int = 1) -> DisplayPlan:
    rng = np.random.default_rng(seed)
    pixel = CENTRE + rng.uniform(-100, 100, (ROWS, 2))
    place = bench.stage.origin + rng.uniform(-4e-3, 4e-3, (ROWS, 3))
    count = np.arange(ROWS)
    return DisplayPlan(count, np.asarray(10.0 * count), np.where(count % 2, 1.0, -1.0), place, count % 3, pixel)


def see_through_plan(bench: Bench, seed: int = 2) -> SeeThroughPlan:
    shown = display_plan(bench, seed)
    dot = np.random.default_rng(seed).uniform(-0.1, 0.1, (ROWS, 2))
    return SeeThroughPlan(shown.capture, shown.time_s, shown.travel, shown.stage, np.zeros(ROWS, dtype=int), dot)


def plan_of(bench: Bench) -> SessionPlan:
    return SessionPlan(display_plan(bench), see_through_plan(bench))


def panel(bench: Bench, plan: DisplayPlan) -> FloatArray:
    return present(simulate(bench, SessionPlan(display=plan)).panel_pixel)


def dots(bench: Bench, plan: SeeThroughPlan) -> FloatArray:
    return present(simulate(bench, SessionPlan(see_through=plan)).dot_pixel)


def read(bench: Bench, plan: DisplayPlan | SeeThroughPlan) -> FloatArray:
    return panel(bench, plan) if isinstance(plan, DisplayPlan) else dots(bench, plan)


def projected(point: FloatArray, camera_position: FloatArray, device_from_camera: FloatArray) -> FloatArray:
    """The textbook's pinhole with v down: camera pixels (n, 2) of points (n, 3)."""
    x, y, z = ((point - camera_position) @ device_from_camera).T
    return np.asarray(CENTRE + np.column_stack([FOCAL[0] * x / -z, FOCAL[1] * y / z]))


class TestClosedForms:
    @pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.03, -0.05, 0.2)])
    def test_without_optics_the_camera_is_a_pinhole(self, turn: tuple[float, float, float]) -> None:
        turned = rotations_of_vectors(np.array(turn))
        bench = with_camera(bench_with("no_optics"), device_from_camera=turned)
        plan = see_through_plan(bench)
        point = np.column_stack([plan.dot, np.full(ROWS, -DISTANCE)])
        np.testing.assert_allclose(dots(bench, plan), projected(point, plan.stage, turned), atol=1e-9)

    def test_what_a_camera_pixel_decodes_is_seen_in_that_pixel(self) -> None:
        turned = rotations_of_vectors(np.array([0.03, -0.05, 0.2]))
        bench = with_camera(bench_with("no_optics"), device_from_camera=turned)
        plan = display_plan(bench)
        x, y = ((panel(bench, plan) / [1280, 720] - 0.5) * [0.32, -0.18]).T
        point = np.column_stack([x, y, np.full(ROWS, -0.5)])
        np.testing.assert_allclose(projected(point, plan.stage, turned), plan.camera_pixel, atol=1e-9)

    def test_a_flat_mirror_shows_the_panel_at_80_mm(self) -> None:
        bench = bench_with("flat_mirror")
        plan = display_plan(bench)
        x, y = ((panel(bench, plan) / [1920, 1080] - 0.5) * [0.048, -0.027]).T
        image = np.column_stack([x, y, np.full(ROWS, -0.08)])
        np.testing.assert_allclose(projected(image, plan.stage, STRAIGHT), plan.camera_pixel, atol=1e-8)

    def test_through_a_plane_plate_dots_are_nearer_by_the_textbook_amount(self) -> None:
        """Rays at the angle a leave a plate shifted back by t (1 - tan a' / tan a), with sin a = n sin a'."""
        bench = bench_with("plane_plate")
        plan = see_through_plan(bench)
        tangents = (dots(bench, plan) - CENTRE) / FOCAL * [1, -1]
        sine = np.sin(np.arctan(np.linalg.norm(tangents, axis=1)))
        inside = np.tan(np.arcsin(sine / 1.5))
        nearer = 0.005 * (1 - inside / np.linalg.norm(tangents, axis=1))
        depth = DISTANCE + plan.stage[:, 2] - nearer
        np.testing.assert_allclose(plan.stage[:, :2] + depth[:, None] * tangents, plan.dot, atol=1e-10)
        near_axis = replace(plan, dot=0.1 * plan.dot, stage=np.broadcast_to(bench.stage.origin, (ROWS, 3)))
        paraxial = CENTRE + FOCAL * [1, -1] * near_axis.dot / (DISTANCE - 0.005 * (1 - 1 / 1.5))
        np.testing.assert_allclose(dots(bench, near_axis), paraxial, atol=2e-5)

    def test_lens_distortion_is_undone(self) -> None:
        camera = replace(bench_with("no_optics").camera, distortion=np.array([-0.15, 0.03]))
        tangents = np.random.default_rng(3).uniform(-0.6, 0.6, (3, 1, 2, 2))
        np.testing.assert_allclose(camera.tangents_of_pixel(camera.pixel_of_tangents(tangents)), tangents, atol=1e-14)

    def test_a_barrel_pulls_points_towards_the_centre_by_the_cube_of_the_radius(self) -> None:
        camera = replace(bench_with("no_optics").camera, distortion=np.array([-0.1, 0.0]))
        straight = replace(camera, distortion=np.zeros(2))
        tangents = np.array([[0.2, 0.0], [0.4, 0.0]])
        pulled = straight.pixel_of_tangents(tangents) - camera.pixel_of_tangents(tangents)
        np.testing.assert_allclose(pulled, [[0.1 * 0.2**3 * FOCAL[0], 0.0], [0.1 * 0.4**3 * FOCAL[0], 0.0]], atol=1e-9)


class TestCameraAndStage:
    def test_a_camera_farther_right_sees_dots_farther_left(self) -> None:
        bench = bench_with("no_optics")
        plan = see_through_plan(bench)
        moved = dots(with_camera(bench, pupil_offset=np.array([1e-3, 0.0, 0.0])), plan) - dots(bench, plan)
        depth = DISTANCE + plan.stage[:, 2]
        np.testing.assert_allclose(moved, np.column_stack([-FOCAL[0] * 1e-3 / depth, np.zeros(ROWS)]), atol=1e-9)

    def test_a_camera_farther_up_sees_a_higher_row_of_the_panel(self) -> None:
        bench = bench_with("no_optics")
        plan = display_plan(bench)
        moved = panel(with_camera(bench, pupil_offset=np.array([0.0, 1e-3, 0.0])), plan) - panel(bench, plan)
        np.testing.assert_allclose(moved, np.tile([0.0, -720 * 1e-3 / 0.18], (ROWS, 1)), atol=1e-9)

    def test_turning_the_camera_between_captures_turns_its_own_axes_with_it(self) -> None:
        """Through optics as well: a plan's orientation acts on the camera as it is mounted, not the other way round."""
        bench = bench_with("northstar")
        mounted, turned = rotations_of_vectors(np.array([[0.02, -0.03, 0.1], [-0.05, 0.08, 0.03]]))
        plan = see_through_plan(bench)
        both = replace(plan, orientation=np.broadcast_to(turned, (ROWS, 3, 3)))
        np.testing.assert_array_equal(
            dots(with_camera(bench, device_from_camera=mounted), both),
            dots(with_camera(bench, device_from_camera=turned @ mounted), plan),
        )

    def test_the_stage_is_wrong_about_its_origin(self) -> None:
        axes = rotations_of_vectors(np.array([0.0, 0.0, 0.01])) @ np.diag([1.02, 1.0, 0.99])
        bench = bench_with("no_optics")
        plan = see_through_plan(bench)
        origin = np.array([1e-3, -2e-3, 0.5e-3])
        true = origin + (plan.stage - origin) @ axes.T
        np.testing.assert_allclose(
            dots(replace(bench, stage=Stage(origin, axes)), plan), dots(bench, replace(plan, stage=true)), atol=1e-9
        )

    def test_backlash_is_added_to_x_by_the_direction_of_the_last_move(self) -> None:
        bench = bench_with("no_optics")
        wrong = replace(bench, stage=replace(bench.stage, backlash=np.array([1e-4, -3e-4])))
        for plan in (display_plan(bench), see_through_plan(bench)):
            shift = np.where(plan.travel > 0, 1e-4, -3e-4)[:, None] * [1.0, 0.0, 0.0]
            np.testing.assert_allclose(read(wrong, plan), read(bench, replace(plan, stage=plan.stage + shift)))


class TestMount:
    def test_a_slip_acts_from_its_time_on(self) -> None:
        bench = bench_with("northstar")
        turn = np.array([2e-3, -1e-3, 3e-3])
        slip = np.array([5e-4, -2e-4, 3e-4])
        slipped = replace(bench, mount=Mount(slip_time_s=300.0, slip=slip, slip_rotation=turn))
        moved = with_camera(bench, pupil_offset=slip, device_from_camera=rotations_of_vectors(turn))
        for plan in (display_plan(bench), see_through_plan(bench)):
            late = plan.time_s >= 300.0
            assert late[30]
            assert not late[29]
            expected = np.where(late[:, None], read(moved, plan), read(bench, plan))
            np.testing.assert_allclose(read(slipped, plan), expected, atol=1e-9)

    def test_a_slip_turns_a_camera_that_is_turned_already(self) -> None:
        turned = rotations_of_vectors(np.array([0.1, 0.2, -0.1]))
        bench = with_camera(bench_with("northstar"), device_from_camera=turned)
        turn = np.array([0.02, -0.03, 0.05])
        slipped = replace(bench, mount=Mount(slip_time_s=0.0, slip_rotation=turn))
        moved = with_camera(bench, device_from_camera=rotations_of_vectors(turn) @ turned)
        for plan in (display_plan(bench), see_through_plan(bench)):
            np.testing.assert_allclose(read(slipped, plan), read(moved, plan), atol=1e-9)

    def test_a_creep_ends_where_a_panel_that_is_moved_stands(self) -> None:
        bench = bench_with("northstar")
        plan = display_plan(bench)
        crept = replace(bench, mount=Mount(panel_creep=np.array([4e-5, -7e-5]), warm_up_s=200.0))
        old = bench.optics.panel
        new = replace(old, device_from_panel=old.device_from_panel @ rigid(np.eye(3), np.array([4e-5, -7e-5, 0.0])))
        device = replace(bench.device, eyes={"right": replace(bench.optics, panel=new)})
        whole = panel(replace(bench, device=device), plan) - panel(bench, plan)
        part = 1 - np.exp(-plan.time_s / 200.0)
        np.testing.assert_allclose(panel(crept, plan) - panel(bench, plan), part[:, None] * whole, atol=1e-8)

    def test_what_is_decoded_is_undone(self) -> None:
        mount = Mount(panel_creep=np.array([4e-5, -7e-5]))
        shift = np.array([[0.3, -0.2], [0.0, 0.0], [1.1, 0.7]])
        readout = PanelReadout(np.array([0.5, -1.0]), np.array([0.99, 1.0, 1.02]), shift)
        bench = bench_with("northstar", mount=mount, readout=readout)
        plan = display_plan(bench)
        pixel = np.random.default_rng(4).uniform(0, 1400, (ROWS, 2))
        np.testing.assert_allclose(undecoded(bench, plan, decoded(bench, plan, pixel)), pixel, atol=1e-10)

    def test_colours_are_magnified_about_the_centre_and_offset_alike(self) -> None:
        bench = bench_with("no_optics")
        plan = display_plan(bench)
        shift = np.array([[0.3, -0.2], [0.0, 0.0], [1.1, 0.7]])
        wrong = replace(bench, readout=PanelReadout(np.array([0.5, -1.0]), np.array([0.99, 1.0, 1.02]), shift))
        scale = np.array([0.99, 1.0, 1.02])[plan.channel][:, None]
        centre = np.array([640.0, 360.0])
        expected = centre + scale * (panel(bench, plan) - centre) + [0.5, -1.0] + shift[plan.channel]
        np.testing.assert_allclose(panel(wrong, plan), expected, atol=1e-9)

    def test_each_colour_is_traced_at_its_own_wavelength(self) -> None:
        bench = bench_with("birdbath28")
        plan = display_plan(bench)
        in_green = panel(bench, replace(plan, channel=np.ones(ROWS, dtype=int)))
        in_red = panel(bench, replace(plan, channel=np.zeros(ROWS, dtype=int)))
        assert np.abs(in_red - in_green).max() > 1e-3  # the plate's dispersion
        swapped = replace(bench, wavelengths_um=(0.55, 0.65, 0.45))
        np.testing.assert_array_equal(panel(swapped, replace(plan, channel=np.ones(ROWS, dtype=int))), in_red)


class TestTarget:
    def test_a_bowed_target_comes_towards_its_own_z(self) -> None:
        bench = bench_with("no_optics")
        plan = see_through_plan(bench)
        target = replace(bench.target, scale=np.array([1.01, 0.98]), bow=np.array([[0.3, -0.5]]))
        x, y = (plan.dot * [1.01, 0.98]).T
        point = np.column_stack([x, y, -DISTANCE + 0.3 * x**2 - 0.5 * y**2])
        np.testing.assert_allclose(
            dots(replace(bench, target=target), plan), projected(point, plan.stage, STRAIGHT), atol=1e-9
        )

    def test_tracking_is_wrong_in_the_device_frame(self) -> None:
        bench = bench_with("no_optics")
        plan = see_through_plan(bench)
        wrong = rigid(rotations_of_vectors(np.array([0.01, -0.02, 0.03])), np.array([1e-3, 2e-3, -3e-3]))
        reported = np.column_stack([plan.dot, np.full(ROWS, -DISTANCE), np.ones(ROWS)])
        point = (reported @ wrong.T)[:, :3]
        tracked = replace(bench, tracking=Tracking(wrong))
        np.testing.assert_allclose(dots(tracked, plan), projected(point, plan.stage, STRAIGHT), atol=1e-9)

    def test_each_row_has_the_pose_and_the_bow_it_names(self) -> None:
        bench = bench_with("northstar")
        poses = np.concatenate([bench.target.device_from_target] * 2)
        poses[1, 2, 3] -= 0.5
        both = replace(bench, target=Target(poses, np.full(2, 0.02), bow=np.array([[0.1, 0.2], [0.3, 0.4]])))
        plan = replace(see_through_plan(bench), target_pose=np.arange(ROWS) % 2)
        for pose in (0, 1):
            alone = Target(poses[pose : pose + 1], np.full(1, 0.02), bow=both.target.bow[pose : pose + 1])
            rows = plan.target_pose == pose
            expected = dots(replace(bench, target=alone), see_through_plan(bench))
            np.testing.assert_array_equal(dots(both, plan)[rows], expected[rows])

    def test_a_photograph_without_the_headset_makes_the_target_and_the_camera_irrelevant(self) -> None:
        bench = bench_with("no_optics")
        bare = dots(bench, see_through_plan(bench))
        plan = replace(see_through_plan(bench), bare_pixel=bare)
        wrong = replace(
            with_camera(bench, device_from_camera=rotations_of_vectors(np.array([0.0, 0.01, 0.0]))),
            target=replace(bench.target, scale=np.array([1.05, 0.97]), bow=np.array([[0.3, -0.5]])),
            tracking=Tracking(rigid(np.eye(3), np.array([3e-3, 0.0, 5e-3]))),
        )
        np.testing.assert_allclose(dots(wrong, plan), bare, atol=1e-9)

    def test_through_optics_a_bare_photograph_leaves_a_small_part_of_the_targets_errors(self) -> None:
        bench = bench_with("northstar")
        plan = see_through_plan(bench)
        bare = dots(bench_with("no_optics", target=bench.target, stage=bench.stage), plan)
        scaled = replace(bench, target=replace(bench.target, scale=np.array([1.05, 1.05])))
        with_bare = replace(plan, bare_pixel=bare)
        np.testing.assert_allclose(dots(bench, with_bare), dots(bench, plan), atol=1e-8)
        seen = np.abs(dots(scaled, plan) - dots(bench, plan)).max()
        assert np.abs(dots(scaled, with_bare) - dots(bench, with_bare)).max() < 0.01 * seen

    def test_dots_behind_the_camera_and_panels_beside_the_view_are_not_seen(self) -> None:
        bench = bench_with("no_optics")
        behind = replace(bench.target, device_from_target=rigid(np.eye(3), np.array([[0.0, 0.0, 0.3]])))
        assert np.isnan(dots(replace(bench, target=behind), see_through_plan(bench))).all()
        backwards = with_camera(bench, device_from_camera=rotations_of_vectors(np.array([0.0, np.pi, 0.0])))
        assert np.isnan(panel(backwards, display_plan(bench))).all()


class TestNeighbours:
    @pytest.mark.parametrize("device", ["northstar", "birdbath28", "freeform40"])
    def test_sights_of_a_neighbour_change_no_result(self, device: str) -> None:
        bench = bench_with(device)
        plan = see_through_plan(bench)
        near = with_camera(bench, pupil_offset=np.array([2e-3, -1e-3, 1e-3]))
        cold, fast = DotViews(bench, plan), DotViews(bench, plan, DotViews(near, plan))
        assert np.isfinite(cold.tangents).mean() > 0.9
        np.testing.assert_allclose(fast.tangents, cold.tangents, atol=1e-11)
        session = SessionPlan(see_through=plan)
        np.testing.assert_allclose(
            present(simulate(bench, session, Views(fast)).dot_pixel), dots(bench, plan), atol=1e-8
        )
