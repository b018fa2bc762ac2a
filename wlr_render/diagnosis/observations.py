"""All readings of a session as one list of two-vectors in units of the noise, grouped by capture.

A display reading is a panel position, but its noise arises in camera pixels; it is transformed there by the local
Jacobian of panel position by camera pixel, so that all residuals below are camera pixels over sigma.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import dot_geometry, panel_pixels
from wlr_render.captures.session import Readings, Session, SessionPlan, select_rows
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.cells import Cells

DISPLAY, SEE_THROUGH, RUN_TIME = 0, 1, 2
PART_NAMES = ("display", "see-through", "run-time")
PART_UNITS = ("panel px", "arcmin", "arcmin")
"""Unit of the residual of each part of a session."""
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_SAME_DISTANCE = 1.05  # ratio of neighbouring distances up to which they count as equal
_PIXEL_STEP = 0.5  # step of the central differences for the noise, camera pixels


@dataclass(frozen=True, order=True)
class CaptureName:
    """A capture: all photographs from one place, or one recording.

    Attributes:
        part: index into `PART_NAMES`.
        target_pose: number of the target's pose; -1 without a target.
        capture: number of the capture in the table.
    """

    part: int
    target_pose: int
    capture: int

    def __str__(self) -> str:
        pose = f" of target pose {self.target_pose}" if self.target_pose >= 0 else ""
        return f"{PART_NAMES[self.part]} capture {self.capture}{pose}"


@dataclass(frozen=True, eq=False)
class Observations:
    """A session ready to be compared with predictions.

    Attributes:
        session: the readings.
        nominal: the bench as described.
        sigma_px: (n,) standard deviation of each reading per axis, camera pixels.
        panel_from_camera: (n_display, 2, 2) panel pixels per camera pixel at each display reading.
        captures: captures of the session, sorted; a capture in several colours is several photographs.
        group: (n,) index into `captures` for each reading, display first, then see-through, then run-time.
        part: (n,) index into `PART_NAMES`.
    """

    session: Session
    nominal: Bench
    sigma_px: FloatArray
    panel_from_camera: FloatArray
    captures: tuple[CaptureName, ...]
    group: IntArray
    part: IntArray

    def __len__(self) -> int:
        return len(self.group)

    @cached_property
    def camera_from_panel(self) -> FloatArray:
        """Camera pixels per panel pixel at each display reading, (n_display, 2, 2); NaN where not predicted."""
        known = np.abs(np.linalg.det(self.panel_from_camera)) > 0
        inverse = np.full_like(self.panel_from_camera, np.nan)
        inverse[known] = np.linalg.inv(self.panel_from_camera[known])
        return inverse

    @np.errstate(invalid="ignore")
    def residual(self, predicted: Readings) -> FloatArray:
        """Return measured minus predicted, (n, 2), in units of sigma; NaN without a prediction."""
        measured, parts = self.session.readings, []
        if measured.panel_pixel is not None and predicted.panel_pixel is not None:
            difference = (measured.panel_pixel - predicted.panel_pixel)[:, :, None]
            parts.append((self.camera_from_panel @ difference)[:, :, 0] / self.sigma_of(DISPLAY))
        if measured.dot_pixel is not None and predicted.dot_pixel is not None:
            parts.append((measured.dot_pixel - predicted.dot_pixel) / self.sigma_of(SEE_THROUGH))
        if measured.run_time_pixel is not None and predicted.run_time_pixel is not None:
            # Virtual minus real dot: the difference does not depend on the direction of view.
            difference = measured.run_time_pixel - predicted.run_time_pixel
            parts.append((difference[:, :2] - difference[:, 2:]) / self.sigma_of(RUN_TIME))
        return np.concatenate(parts)

    def sigma_of(self, part: int) -> FloatArray:
        """Return the standard deviations of a part's readings, (n_part, 1) camera pixels."""
        return np.asarray(self.sigma_px[self.part == part][:, None])

    @cached_property
    def part_of_capture(self) -> IntArray:
        """Index into `PART_NAMES` of each capture (captures,)."""
        return np.array([name.part for name in self.captures], dtype=np.int64)

    @cached_property
    def photograph(self) -> IntArray:
        """Number (n,) of the photograph of each reading: a capture in one colour."""
        plan, channel = self.session.plan.display, np.zeros(len(self), dtype=np.int64)
        if plan is not None:
            channel[self.part == DISPLAY] = plan.channel
        return np.asarray(3 * self.group + channel)

    def of_captures(self, name: str, width: int) -> FloatArray:
        """Return a column (n, width) of the capture tables, row by row; zero at run time."""
        plan, values = self.session.plan, np.zeros((len(self), width))
        for part, table in ((DISPLAY, plan.display), (SEE_THROUGH, plan.see_through)):
            if table is not None:
                values[self.part == part] = getattr(table, name).reshape(len(table), width)
        return values

    @cached_property
    def image_place(self) -> FloatArray:
        """Camera pixel (n, 2) of each reading; NaN at run time."""
        place = np.full((len(self), 2), np.nan)
        if self.session.plan.display is not None:
            place[self.part == DISPLAY] = self.session.plan.display.camera_pixel
        if self.session.readings.dot_pixel is not None:
            place[self.part == SEE_THROUGH] = self.session.readings.dot_pixel
        return place

    def in_unit_of(self, part: int, residual: FloatArray) -> FloatArray:
        """Return the residual (n_part, 2) of a part's readings in the part's unit, see `PART_UNITS`."""
        if part != DISPLAY:
            return self.arcminutes(residual, part)
        own = residual[self.part == DISPLAY] * self.sigma_of(DISPLAY)
        return np.asarray((self.panel_from_camera @ own[:, :, None])[:, :, 0])

    def arcminutes(self, residual: FloatArray, part: int) -> FloatArray:
        """Return the residual (n_part, 2) of a part's readings in arcminutes at the middle of the camera's image."""
        own = residual[self.part == part] * self.sigma_of(part)
        return np.asarray(own / (self.nominal.camera.focal_px * ARCMIN))

    def target_distance(self) -> FloatArray:
        """Return the distance (m,) from camera to target, in metres, of each see-through reading, averaged by pose."""
        plan = self.session.plan.see_through
        if plan is None:
            return np.zeros(0)
        viewpoint, point, _ = dot_geometry(self.nominal, plan)
        # Averaged because on a tilted target the distance differs between dots.
        _, pose, count = np.unique(plan.target_pose, return_inverse=True, return_counts=True)
        return np.asarray((np.bincount(pose, np.linalg.norm(point - viewpoint, axis=1)) / count)[pose])

    def target_distances(self) -> dict[str, BoolArray]:
        """Return a mask (n,) of the readings at each target distance from the camera, by name, nearest first."""
        of_row = self.target_distance()
        distances, named = np.unique(of_row), dict[str, BoolArray]()
        steps = np.flatnonzero(distances[1:] > _SAME_DISTANCE * distances[:-1]) + 1
        for group in np.split(distances, steps) if len(distances) else ():
            rows = np.zeros(len(self), dtype=bool)
            rows[self.part == SEE_THROUGH] = (of_row >= group[0]) & (of_row <= group[-1])
            named[" to ".join(dict.fromkeys(f"{each:.2f}" for each in group[[0, -1]])) + " m"] = rows
        return named

    def with_sigma(self, sigma_px: FloatArray) -> "Observations":
        """Return the same readings with another noise (n,), in camera pixels."""
        return replace(self, sigma_px=sigma_px)

    def spread(self, most: int) -> BoolArray:
        """Return a mask (n,) of at most about `most` readings, spread evenly over every capture and part."""
        keep = np.ones(len(self), dtype=bool)
        if len(self) <= most:
            return keep
        present = [part for part in range(len(PART_NAMES)) if np.any(self.part == part)]
        for part in present:
            rows = np.flatnonzero(self.part == part)
            # Multiples of the golden ratio never fall in step with the rows and columns of a grid.
            order = np.argsort(np.mod(np.arange(len(rows)) * _GOLDEN, 1.0), kind="stable")
            keep[rows[order[most // len(present) :]]] = False
        return keep

    def masks(self, keep: BoolArray) -> list[BoolArray]:
        """Split a mask (n,) of all readings into one mask per part."""
        return [keep[self.part == part] for part in range(len(PART_NAMES))]

    def of_rows(self, keep: BoolArray) -> "Observations":
        """Return the readings that a mask (n,) selects."""
        masks = self.masks(keep)
        plans: Iterable[Any] = self.session.plan.parts
        kept_plan = SessionPlan(
            *(None if plan is None else select_rows(plan, mask) for plan, mask in zip(plans, masks, strict=True))
        )
        return replace(
            self,
            session=replace(self.session, plan=kept_plan, readings=readings_of_rows(self.session.readings, masks)),
            panel_from_camera=self.panel_from_camera[masks[DISPLAY]],
            sigma_px=self.sigma_px[keep],
            group=self.group[keep],
            part=self.part[keep],
        )


def readings_of_rows(readings: Readings, masks: Sequence[BoolArray]) -> Readings:
    """Return the rows of each part selected by its mask."""
    return Readings(*(None if part is None else part[mask] for part, mask in zip(readings.parts, masks, strict=True)))


def observed(nominal: Bench, session: Session) -> Observations:
    """Return all readings of a session, whether the nominal bench predicts them or not."""
    plan = session.plan
    part = np.repeat(np.arange(len(PART_NAMES)), [0 if each is None else len(each) for each in plan.parts])
    pose = np.full(len(part), -1)
    if plan.see_through is not None:
        pose[part == SEE_THROUGH] = plan.see_through.target_pose
    numbers = np.stack([part, pose, np.concatenate([each.capture for each in plan.parts if each is not None])], axis=1)
    names, group = np.unique(numbers, axis=0, return_inverse=True)
    captures = tuple(CaptureName(*each) for each in names.tolist())
    jacobian = _panel_from_camera(nominal, plan)
    sigma = _stated_sigma(nominal, plan, part)
    return Observations(session, nominal, sigma, jacobian, captures, group.reshape(-1), part)


def _stated_sigma(nominal: Bench, plan: SessionPlan, part: IntArray) -> FloatArray:
    """Return the standard deviation (n,) that the bench or the reading itself states, camera pixels."""
    # A run-time reading is the difference of two dots.
    sigma = nominal.camera.point_sigma_px * np.where(part == RUN_TIME, np.sqrt(2.0), 1.0)
    for number, table in ((DISPLAY, plan.display), (SEE_THROUGH, plan.see_through)):
        if table is not None and table.sigma_px is not None:
            sigma[part == number] = table.sigma_px
    return np.asarray(sigma)


@np.errstate(invalid="ignore")
def _panel_from_camera(bench: Bench, plan: SessionPlan) -> FloatArray:
    """Return the local Jacobian (n, 2, 2) of panel pixel by camera pixel."""
    if plan.display is None:
        return np.zeros((0, 2, 2))
    # Leave out cells: they have steps at their borders and no slope.
    smooth = tuple(effect for effect in bench.effects if not isinstance(effect.function, Cells))
    bench = bench if len(smooth) == len(bench.effects) else replace(bench, effects=smooth)
    columns = []
    for shift in _PIXEL_STEP * np.eye(2):
        ahead = replace(plan.display, camera_pixel=plan.display.camera_pixel + shift)
        behind = replace(plan.display, camera_pixel=plan.display.camera_pixel - shift)
        columns.append((panel_pixels(bench, ahead) - panel_pixels(bench, behind)) / (2 * _PIXEL_STEP))
    return np.stack(columns, axis=-1)
