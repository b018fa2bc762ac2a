"""The bench that takes photographs: where things stand, and that a camera sees what it is to see."""

from dataclasses import replace

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import (
    PhotoBench,
    PhotoBenchOptions,
    design_photo_bench,
    stage_readings,
)
from wlr_render.simulation.photographs.photo_plan import plan_photographs, unreadable_targets

OPTIONS = PhotoBenchOptions(camera_px=(640, 512), imperfections=BenchImperfections.none())


@pytest.fixture(scope="module", params=["birdbath28", "plane_plate"])
def bench(request: pytest.FixtureRequest) -> PhotoBench:
    return design_photo_bench(load_device(request.param), "right", OPTIONS)


def in_picture(
    lens: SimulatedLens, camera_from_point: FloatArray, point: FloatArray, margin_px: float = 0.0
) -> BoolArray:
    pixel = lens.camera.pixel_of_point(transforms.apply(camera_from_point, point))
    return np.asarray(np.all((pixel > margin_px) & (pixel < np.array(lens.camera.size_px) - margin_px), axis=-1))


def test_the_whole_panel_is_in_the_picture_from_every_place_of_the_sweep(bench: PhotoBench) -> None:
    truth, pixel = traced_eye(bench.device, bench.eye), bench.optics.panel.pixels.grid(9, 7).reshape(-1, 2)
    for reading in stage_readings(bench, 5):
        camera = bench.camera_at(reading)
        seen = truth.display.view_dir_of_pixel(pixel, camera[:3, 3])
        assert seen.usable.any()
        point = camera[:3, 3] + seen.value[seen.usable]
        # What the widest view of the sweep shows may reach beyond what is seen from the eye box, by little.
        assert in_picture(bench.eyeball, transforms.inverse(camera), point).mean() > 0.9


def test_readings_are_what_a_stage_shows_and_lie_in_one_plane(bench: PhotoBench) -> None:
    readings = stage_readings(bench, 9)
    assert readings.shape == (9, 3)
    assert np.array_equal(readings, np.round(readings, 6))
    assert np.all(readings[:, 2] == 0)
    half_box = 0.5 * bench.optics.eye_box.size[:2]
    assert np.all(np.abs(readings[:, :2]).max(axis=0) >= half_box - 1e-6)


def test_volumetric_readings_fill_the_eye_box(bench: PhotoBench) -> None:
    options = replace(OPTIONS, sampling="volumetric")
    readings = stage_readings(replace(bench, options=options), 9)
    half_box = 0.5 * bench.optics.eye_box.size
    assert np.allclose(np.abs(readings).max(axis=0), half_box, atol=1e-6)
    assert np.linalg.matrix_rank(readings - readings.mean(axis=0), tol=1e-4) == 3
    # Along each axis that the sweep uses, five levels of the bare photographs tell a cubic error from a linear one.
    bare = plan_photographs(replace(bench, options=options), 9).bare
    assert [len(np.unique(each)) for each in bare.T] == [5, 5, 5]
    assert len(plan_photographs(replace(bench, options=replace(options, stated_axes_deg=0.1)), 9).bare) == 1


def test_what_a_stage_cannot_do_is_refused() -> None:
    with pytest.raises(BadInputError, match="volumetric sampling needs the stage xyz"):
        PhotoBenchOptions(sampling="volumetric", stage="xy")


def test_both_cameras_see_the_target_wherever_it_stands(bench: PhotoBench) -> None:
    point = bench.board.point_of(bench.board.indices())
    for number, depth in enumerate(OPTIONS.target_depths_m):
        target = bench.device_from_target[number]
        assert np.linalg.norm(target[:3, 3] - bench.optics.eye_box.centre) == pytest.approx(depth)
        for lens, camera in (
            (bench.eyeball, bench.camera_at(np.zeros(3))),
            (bench.tracking, bench.device_from_tracking),
        ):
            seen = in_picture(lens, transforms.inverse(camera) @ target, point)
            assert seen.sum() >= 20
    assert in_picture(bench.tracking, transforms.inverse(bench.device_from_tracking) @ target, point).all()


def test_the_board_can_be_printed_and_covers_the_field_at_the_farthest_place(bench: PhotoBench) -> None:
    short, long = sorted(bench.board.size_m)
    assert short <= 0.841
    assert long <= 1.189
    truth = traced_eye(bench.device, bench.eye)
    camera = bench.camera_at(np.zeros(3))
    seen = truth.display.view_dir_of_pixel(bench.optics.panel.pixels.grid(7, 5).reshape(-1, 2), camera[:3, 3])
    board_from_device = transforms.inverse(bench.device_from_target[-1])
    origin = transforms.apply(board_from_device, camera[:3, 3])
    direction = transforms.rotate(board_from_device, seen.value[seen.usable])
    met = origin + direction * (-origin[2] / direction[:, 2:])
    inside = np.all(np.abs(met[:, :2]) < 0.5 * np.array(bench.board.size_m), axis=1)
    assert inside.mean() > 0.9


def test_the_plan_moves_the_bare_camera_along_every_axis_and_fills_the_lenses(bench: PhotoBench) -> None:
    plan = plan_photographs(bench, 5)
    assert np.all(np.ptp(plan.bare, axis=0) >= 0.5 * bench.optics.eye_box.size)
    assert plan.bare_poses == (0, 1)
    point = bench.board.point_of(bench.board.indices())
    for lens, boards in ((bench.eyeball, plan.eyeball_boards), (bench.tracking, plan.tracking_boards)):
        pixel = np.concatenate([lens.camera.pixel_of_point(transforms.apply(pose, point)) for pose in boards])
        inside = pixel[np.all((pixel > 0) & (pixel < np.array(lens.camera.size_px)), axis=1)]
        counts, _, _ = np.histogram2d(
            inside[:, 0], inside[:, 1], bins=4, range=[(0, side) for side in lens.camera.size_px]
        )
        assert counts.min() > 0  # dots in every sixteenth of the picture


@pytest.mark.parametrize(
    ("eye", "options", "complaint"),
    [
        ("left", OPTIONS, "left"),
        ("right", PhotoBenchOptions(target_depths_m=(0.5,)), "target depths .* give no ray"),
        ("right", PhotoBenchOptions(target_depths_m=(0.5, 0.5)), "target depths .* give no ray"),
        ("right", PhotoBenchOptions(target_depths_m=(0.0, 0.5)), "target depths .* give no ray"),
        ("right", PhotoBenchOptions(snr=0.0), "is impossible"),
        ("right", PhotoBenchOptions(focus_m=0.0), "positive focus"),
    ],
)
def test_benches_that_cannot_be_are_refused(eye: str, options: PhotoBenchOptions, complaint: str) -> None:
    with pytest.raises(BadInputError, match=complaint):
        design_photo_bench(load_device("plane_plate"), eye, options)


def test_pictures_too_small_to_identify_a_near_board_are_named() -> None:
    def said(camera: tuple[int, int], tracking: tuple[int, int]) -> list[str]:
        options = PhotoBenchOptions(camera_px=camera, tracking_px=tracking)
        return unreadable_targets(design_photo_bench(load_device("freeform40"), "right", options))

    assert said((640, 512), (640, 480)) == []
    (sentence,) = said((320, 256), (640, 480))
    assert sentence.startswith(
        "Target pose 0: the eyeball camera's pictures of 320 x 256 pixels are too small to ident"
    )
    assert any(
        "dots of 2" in each and "tracking camera's pictures of 240" in each for each in said((640, 512), (240, 180))
    )
