"""Accuracy of composed frames against ray-traced frames: registration, disocclusion, late correction.

Here a fitted model is the truth: the benchmark measures the errors that the compositor adds to it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.raster.disocclusion import hidden_from, hit_positions
from benchmarks.raster.raster_error import raster_error
from benchmarks.scene_source import SceneSource
from wlr_render.draw.painters import position_of_source, with_inverse_depth
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.evaluation.metrics import summary
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Scene
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.ray_map import RayMapPlan, choose_plan, ray_map

SILHOUETTE_PX = 2


@dataclass(frozen=True, eq=False)
class Subject:
    """One eye of a headset, one scene, and the objects that draw them in both ways.

    Attributes:
        mappings: the eye; the display's picture is its panel.
        compositor: compositor of the eye.
        source: engine that draws the scene for the compositor.
        plan: plan of the eye's exact rays.
        tracer: tracer of the scene, for these rays.
    """

    mappings: Eye
    compositor: Compositor
    source: SceneSource
    plan: RayMapPlan
    tracer: SceneTracer


def subject(mappings: Eye, scene: Scene, context: str = "auto") -> Subject:
    """Return a prepared subject; the caller releases its compositor."""
    panel = mappings.display.panel
    compositor = Compositor(mappings, (panel.width_px, panel.height_px), context=context)
    return Subject(mappings, compositor, SceneSource(compositor, scene), choose_plan(mappings), SceneTracer(scene))


@dataclass(frozen=True, eq=False)
class ScanOutPose:
    """Viewpoint and head pose while a display lights up.

    Attributes:
        viewpoint: (3,) device frame.
        pose: (4, 4) world_from_device, when the first row lights up.
        pose_at_last_row: pose when the last row lights up; None for a display that lights up at once.
    """

    viewpoint: FloatArray
    pose: FloatArray
    pose_at_last_row: FloatArray | None = None

    @property
    def at_once(self) -> "ScanOutPose":
        """Copy with all rows at the time of the first row."""
        return replace(self, pose_at_last_row=None)

    def row_poses(self, rows: int) -> FloatArray:
        """Return the poses (rows, 4, 4) of the display's rows."""
        last = self.pose if self.pose_at_last_row is None else self.pose_at_last_row
        return transforms.between(self.pose, last, np.linspace(0.0, 1.0, rows))


@dataclass(frozen=True)
class Landing:
    """Comparison of a composed frame with the ray-traced one.

    Attributes:
        rms_arcmin, worst_arcmin: angles at the eye between the world points that both frames show at a pixel, at pixels
            SILHOUETTE_PX or more from silhouettes and from disoccluded pixels.
        pixels: number of these pixels.
        disoccluded: pixels that the drawn picture cannot show correctly.
        one_sided: such pixels at which only one of the two frames shows anything.
    """

    rms_arcmin: float
    worst_arcmin: float
    pixels: int
    disoccluded: int
    one_sided: int


@dataclass(frozen=True, eq=False)
class Truth:
    """Correct view at one scan-out, as rays.

    Attributes:
        scan_out: viewpoint and head pose of that scan-out.
        direction: (height, width, 3) direction of each pixel's ray, world frame.
        position: (height, width, 3) world points that the rays hit; NaN for a miss.
    """

    scan_out: ScanOutPose
    direction: FloatArray
    position: FloatArray


def truth(on: Subject, scan_out: ScanOutPose) -> Truth:
    """Trace each row's rays from the head's pose when the row lights up."""
    field = ray_map(on.mappings, scan_out.viewpoint, on.plan)
    shape = (*field.shape, 3)
    origin, direction = (each.reshape(shape) for each in field.world_rays(np.eye(4)))
    poses = scan_out.row_poses(len(origin))
    rotation, translation = poses[:, :3, :3], poses[:, None, :3, 3]
    origin, direction = (
        np.matmul(origin, np.swapaxes(rotation, 1, 2)),
        np.matmul(direction, np.swapaxes(rotation, 1, 2)),
    )
    origin = origin + translation
    return Truth(
        scan_out, direction, hit_positions(on.tracer, on.tracer.intersect(origin, direction), origin, direction)
    )


def landing(on: Subject, seen: Truth, drawn: ScanOutPose, composed: ScanOutPose) -> Landing:
    """Draw for one scan-out, compose for a second, and compare with the correct view at a third."""
    (camera,) = on.compositor.begin_frame(drawn.pose, drawn.viewpoint).values()
    on.source.submit(camera)
    frame = on.compositor.compose(
        pose=composed.pose,
        viewpoint=composed.viewpoint,
        pose_at_last_row=composed.pose_at_last_row,
        with_source=True,
    )
    shown = position_of_source(camera.view, with_inverse_depth(on.source.read(camera.view), frame.source()))
    hidden = _hidden(on, seen, camera.view.position_in_world)
    poses, eye = seen.scan_out.row_poses(len(shown)), seen.scan_out.viewpoint
    shown_in_device, seen_in_device = _in_device(poses, shown), _in_device(poses, seen.position)
    error = raster_error(shown_in_device, seen_in_device, eye)
    apart = cv2.dilate(hidden.astype(np.uint8), np.ones((2 * SILHOUETTE_PX + 1,) * 2, np.uint8)) == 0
    apart &= ~near_silhouettes(seen_in_device, eye, SILHOUETTE_PX)
    found = summary(error.registration_arcmin[apart])
    one_sided = int((error.only_one & apart).sum())
    return Landing(found.rms, found.maximum, found.count, int(hidden.sum()), one_sided)


def disoccluded_at_pupil(on: Subject, seen: Truth) -> int:
    """Count the pixels that a picture drawn from the pupil itself cannot show correctly."""
    return int(_hidden(on, seen, transforms.apply(seen.scan_out.pose, seen.scan_out.viewpoint)).sum())


def _hidden(on: Subject, seen: Truth, place_in_world: FloatArray) -> NDArray[np.bool_]:
    return hidden_from(on.tracer, place_in_world, seen.direction, seen.position)


def _in_device(row_poses: FloatArray, position: NDArray[np.floating]) -> FloatArray:
    """Return world points (rows, columns, 3) in the device frame at the time their row lights up."""
    rotation, translation = row_poses[:, :3, :3], row_poses[:, None, :3, 3]
    return np.asarray(np.matmul(position - translation, rotation))


EDGE_STEP = 0.02
"""Relative difference of inverse distance above which neighbouring pixels belong to different surfaces."""


def near_silhouettes(
    position: NDArray[np.floating], eye_in_world: NDArray[np.float64], reach_px: int
) -> NDArray[np.bool_]:
    """Return the mask of pixels near edges between surfaces at different distances.

    Args:
        position: (height, width, 3) world points that a frame shows, NaN for none.
        eye_in_world: (3,) viewpoint.
        reach_px: distance from the edge, along rows and columns.

    Returns:
        (height, width). Neighbours belong to different surfaces if their inverse distances differ by more than
        `EDGE_STEP` of the larger; background is at infinity.
    """
    distance = np.linalg.norm(np.asarray(position, np.float64) - eye_in_world, axis=-1)
    nearness = np.where(np.isfinite(distance), 1.0 / distance, 0.0).astype(np.float32)
    square = np.ones((3, 3), np.uint8)
    low, high = np.asarray(cv2.erode(nearness, square)), np.asarray(cv2.dilate(nearness, square))
    edge = (high - low > EDGE_STEP * high).astype(np.uint8)
    return np.asarray(cv2.dilate(edge, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8))) > 0
