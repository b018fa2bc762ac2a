"""Simulate the readings of a session's photographs, without the photographs.

Camera poses, lenses, board and optics are the same as in `simulate_photo_session`. Dots and panel positions are exact
plus white noise; errors of dot detection and of decoding are not simulated.
"""

import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulated_lab.bench_truth import BenchTruth, known_number, true_values
from benchmarks.simulated_lab.exact_views import panel_position, pixel_of_point, pixel_of_real_point
from benchmarks.simulated_lab.faults import NO_FAULTS, Exchange, Faults
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.decoded import DecodedSamples, Rejection
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.captures.session_reading import PanelReading, Reading
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_plan import PhotoPlan, plan_photographs, planned_session, true_camera_poses
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.workshop import Workshop

_EDGE_PX = 6.0  # smallest distance from the edge of the picture to the centre of a dot
_NEAR = 1.1  # search range over the picture's size; the optics bring no point from beyond it into the picture
_USUAL = ReadingOptions()
_COARSE = 24  # number of camera pixels across in the search for the panel


@dataclass(frozen=True, eq=False)
class SimulatedReadings:
    """A session, its readings and the truth.

    Attributes:
        session: content of session.toml, with the faults of its readings.
        reading: result of `read_session`.
        truth: the true values.
    """

    session: PhotoSession
    reading: Reading
    truth: BenchTruth


def simulate_readings(
    recipe: SimulationRecipe,
    options: ReadingOptions = _USUAL,
    *,
    faults: Faults = NO_FAULTS,
    folder: Path = Path("simulated"),
) -> SimulatedReadings:
    """Simulate the readings of the session that `simulate_photo_session` would photograph with this recipe.

    Args:
        recipe: device, eye, number of camera positions, bench and seed.
        options: noise and number of readings.
        faults: faults of the session.
        folder: folder in the names of photographs; nothing is read or written there.

    Raises:
        BadInputError: an unknown device, eye or pattern, or a fault of a missing photograph.
    """
    bench = recipe.build()
    off = np.deg2rad(faults.axis_off_deg)
    skew = np.array([[1.0, np.sin(off), 0.0], [0.0, np.cos(off), 0.0], [0.0, 0.0, 1.0]])
    bench = replace(bench, stage_axes=bench.stage_axes @ skew)
    plan = plan_photographs(bench, recipe.viewpoints)
    visits = true_camera_poses(bench, plan)
    session = planned_session(folder, bench, plan, visits, make_pattern(recipe.pattern, bench.optics.panel.pixels))
    truth = true_values(session, bench, visits, faults)
    reading = _Reader(session, truth, options).reading(plan)
    if faults.exchanged is not None:
        session = _exchanged(session, faults.exchanged)
    return SimulatedReadings(session, reading, truth)


def _exchanged(session: PhotoSession, fault: Exchange) -> PhotoSession:
    entries = list(getattr(session, fault.of, ()))
    first, second = (known_number(number, range(len(entries)), fault.of) for number in (fault.first, fault.second))
    one, other = entries[first], entries[second]
    entries[first] = replace(one, stage=other.stage, place=other.place)
    entries[second] = replace(other, stage=one.stage, place=one.place)
    changed: dict[str, Any] = {fault.of: tuple(entries)}
    return replace(session, **changed)


@dataclass(frozen=True, eq=False)
class _Reader:
    """Reader of photographs that were not taken."""

    session: PhotoSession
    truth: BenchTruth
    options: ReadingOptions

    def reading(self, plan: PhotoPlan) -> Reading:
        session, truth = self.session, self.truth
        boards: dict[Path, BoardObservation] = {}

        bench = truth.bench

        def free(path: Path, lens: LensCamera, camera_from_target: FloatArray) -> None:
            boards[path] = self._free(path, lens, bench.eyeball.workshop, camera_from_target)

        def tracked(path: Path, camera_from_target: FloatArray) -> None:
            boards[path] = self._free(path, bench.tracking.camera, bench.tracking.workshop, camera_from_target)

        for path, pose in zip(session.eyeball_camera.intrinsics, plan.eyeball_boards, strict=True):
            free(path, bench.eyeball.camera, pose)
        tracking = () if session.tracking_camera is None else session.tracking_camera.intrinsics
        for path, pose in zip(tracking, plan.tracking_boards, strict=True):
            tracked(path, pose)
        for each, camera, target in zip(session.bare, truth.bare, truth.bare_targets, strict=True):
            lens = truth.eyeball_at_target[each.target_pose]
            free(each.path, lens, transforms.inverse(camera) @ target)
        for each, target in zip(session.tracking, truth.tracking_targets, strict=True):
            tracked(each.path, transforms.inverse(bench.device_from_tracking) @ target)
        for each, camera, target in zip(session.see_through, truth.see_through, truth.see_through_targets, strict=True):
            boards[each.path] = self._through(each.path, truth.eyeball_at_target[each.target_pose], camera, target)
        panels = {
            each.folder: self._panel(each.folder, camera)
            for each, camera in zip(session.display, truth.display, strict=True)
        }
        return Reading(
            {path: seen for path, seen in boards.items() if len(seen)},
            {path: seen for path, seen in panels.items() if len(seen.samples)},
        )

    def _free(
        self, path: Path, lens: LensCamera, workshop: Workshop | None, camera_from_target: FloatArray
    ) -> BoardObservation:
        """Return the reading of the board without the optics."""
        rng = self._rng(path)
        point = transforms.apply(camera_from_target, self.truth.bench.printed.points)
        pixel = pixel_of_point(lens, point, workshop)
        number = self._chosen(_inside(pixel, lens.size_px, _EDGE_PX), rng)
        return self._observed(number, pixel[number], rng)

    def _through(
        self, path: Path, camera: LensCamera, device_from_camera: FloatArray, device_from_target: FloatArray
    ) -> BoardObservation:
        """Return the reading of the board through the optics."""
        rng = self._rng(path)
        point = transforms.apply(device_from_target, self.truth.bench.printed.points)
        straight = camera.pixel_of_point(transforms.apply(transforms.inverse(device_from_camera), point))
        near = _inside(straight, camera.size_px, -(_NEAR - 1.0) * max(camera.size_px))
        number = self._chosen(near, rng)
        bench = self.truth.bench
        pixel = pixel_of_real_point(bench.optics, camera, device_from_camera, point[number], bench.eyeball.workshop)
        seen = _inside(pixel, camera.size_px, _EDGE_PX)
        return self._observed(number[seen], pixel[seen], rng)

    def _chosen(self, seen: BoolArray, rng: np.random.Generator) -> IntArray:
        number = np.flatnonzero(seen)
        if len(number) > self.options.most_dots:
            number = np.sort(rng.choice(number, self.options.most_dots, replace=False))
        return number

    def _observed(self, number: IntArray, pixel: FloatArray, rng: np.random.Generator) -> BoardObservation:
        noise = self.options.dot_px
        index = self.session.board.indices()[number]
        sigma = np.full(len(number), noise)
        return BoardObservation(index, pixel + rng.normal(0.0, noise, pixel.shape), sigma)

    def _panel(self, folder: Path, device_from_camera: FloatArray) -> PanelReading:
        camera, rng = self.truth.bench.eyeball.camera, self._rng(folder)
        width, height = camera.size_px
        lit = self._panel_at(_grid(camera.size_px, max(width, height) / _COARSE), device_from_camera)
        share = max(float(np.isfinite(lit[..., 0]).mean()), 1.0 / lit.size)
        every = max(1.0, np.floor(np.sqrt(share * width * height / self.options.panel_samples)))
        pixel = _grid(camera.size_px, every)
        place = self._panel_at(pixel, device_from_camera)
        down, right = (np.gradient(place, every, axis=axis) for axis in (0, 1))
        scale = np.sqrt(np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]))
        seen = np.isfinite(place).all(axis=-1) & np.isfinite(scale)
        found = place[seen] + rng.normal(0.0, self.options.panel_px, (int(seen.sum()), 2))
        sigma = np.full(len(found), self.options.panel_px)
        counts = np.zeros(len(Rejection), dtype=np.int64)
        counts[Rejection.ACCEPTED], counts[Rejection.DARK] = seen.sum(), (~seen).sum()
        fates = np.where(seen, Rejection.ACCEPTED, Rejection.DARK).astype(np.uint8)
        extent = np.stack([found.min(axis=0), found.max(axis=0)]) if len(found) else np.zeros((2, 2))
        return PanelReading(DecodedSamples(pixel[seen], found, sigma, scale[seen]), counts, fates, extent)

    def _panel_at(self, pixel: FloatArray, device_from_camera: FloatArray) -> FloatArray:
        bench = self.truth.bench
        lens, workshop = bench.eyeball.camera, bench.eyeball.workshop
        return panel_position(bench.optics, lens, device_from_camera, pixel, workshop).value

    def _rng(self, path: Path) -> np.random.Generator:
        """Return the noise generator of one photograph, which does not depend on the other photographs."""
        bench = self.truth.bench
        name = zlib.crc32(self.session.name_of(path).encode())
        return np.random.default_rng([bench.options.seed, 23, name, int(bench.eye == "left")])


def _inside(pixel: FloatArray, size_px: tuple[int, int], edge_px: float) -> BoolArray:
    """Return True for pixels (..., 2) more than `edge_px` inside a picture, and False for NaN."""
    return np.asarray(np.all((pixel > edge_px) & (pixel < np.array(size_px) - edge_px), axis=-1))


def _grid(size_px: tuple[int, int], every: float) -> FloatArray:
    """Return the centres (rows, columns, 2) of pixels on a grid with step `every`."""
    u, v = (np.floor(np.arange(0.5 * every, length, every)) + 0.5 for length in size_px)
    return np.stack(np.meshgrid(u, v), axis=-1)
