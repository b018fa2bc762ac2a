"""How far composed frames are from ray-traced ones: where they land, what they cannot see, and what is left when late.

A fitted model stands for the truth here: the question is what the compositor adds to it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.scene_source import SceneSource
from wlr_render.evaluation.disocclusion import disoccluded
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.raster_error import near_silhouettes, raster_error
from wlr_render.geometry import transforms
from wlr_render.mappings import EyeMappings, FloatArray
from wlr_render.rendering.painters import TracedPainter, position_of_source, with_inverse_depth
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.rendering.raytrace import SceneTracer
from wlr_render.rendering.scene import Scene

SILHOUETTE_PX = 2
LATE_S = 0.010
TURN_DEG_PER_S, WALK_M_PER_S, PUPIL_M_PER_S = 100.0, 0.5, 0.05
"""A brisk turn of the head, a step, and a pupil 10.5 mm before the centre of an eye that turns by 270 deg/s."""


@dataclass(frozen=True, eq=False)
class Subject:
    """One eye of a headset, one scene, and what draws them both ways.

    Attributes:
        mappings: the eye; the display's picture is its panel.
        scene: in the world.
        compositor: of the eye.
        source: draws the scene for it.
        traced: draws it by its rays.
        tracer: of the scene.
    """

    mappings: EyeMappings
    scene: Scene
    compositor: Compositor
    source: SceneSource
    traced: TracedPainter
    tracer: SceneTracer


def subject(mappings: EyeMappings, scene: Scene, context: str = "auto") -> Subject:
    """Everything ready; release its compositor."""
    panel = mappings.display.panel
    compositor = Compositor(mappings, (panel.width_px, panel.height_px), context=context)
    renderer = RayRenderer(scene)
    source = SceneSource(compositor, scene)
    return Subject(mappings, scene, compositor, source, TracedPainter(mappings, renderer), renderer.tracer)


@dataclass(frozen=True)
class Landing:
    """A composed frame beside the ray-traced one.

    Attributes:
        rms_arcmin, worst_arcmin: angles at the eye between the world points that both show at a pixel, SILHOUETTE_PX
            away from silhouettes and from what is disoccluded.
        disoccluded: pixels that the picture drawn cannot show right.
        pixels: that the figures are of.
    """

    rms_arcmin: float
    worst_arcmin: float
    disoccluded: int
    pixels: int


@dataclass(frozen=True, eq=False)
class Moment:
    """(3,) viewpoint in the device frame, and (4, 4) world_from_device."""

    viewpoint: FloatArray
    pose: FloatArray


def landing(on: Subject, drawn: Moment, seen: Moment, corrected: bool = True) -> Landing:
    """Draw for one moment, show at another, and compare with what should be shown then.

    `corrected` composes for the moment in which it is seen; else for the one in which it was drawn.
    """
    (camera,) = on.compositor.begin_frame(drawn.pose, drawn.viewpoint).values()
    on.source.submit(camera)
    shown_for = seen if corrected else drawn
    composed = on.compositor.compose(pose=shown_for.pose, viewpoint=shown_for.viewpoint, with_source=True)
    image = on.source.read(camera.view)
    shown = position_of_source(camera.view, with_inverse_depth(image, composed.source()))
    traced, hidden = _traced(on, seen, camera.view.viewpoint_in_world)
    eye_in_world = transforms.apply(seen.pose, seen.viewpoint)
    angle = raster_error(shown, traced, eye_in_world).registration_arcmin
    near_hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((2 * SILHOUETTE_PX + 1,) * 2, np.uint8)) > 0
    found = summary(angle[~(near_hidden | near_silhouettes(traced, eye_in_world, SILHOUETTE_PX))])
    return Landing(found.rms, found.maximum, int(hidden.sum()), found.count)


def disoccluded_from(on: Subject, moment: Moment, at_viewpoint: bool) -> int:
    """Pixels that a picture cannot show right that is drawn from the viewpoint itself, or from where rays come."""
    (camera,) = on.compositor.begin_frame(moment.pose, moment.viewpoint).values()
    eye_in_world = transforms.apply(moment.pose, moment.viewpoint)
    _, hidden = _traced(on, moment, eye_in_world if at_viewpoint else camera.view.viewpoint_in_world)
    return int(hidden.sum())


def _traced(on: Subject, moment: Moment, drawn_from: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """World points that the rays of a moment meet, (height, width, 3), and which of them are hidden from a place."""
    frame = on.traced.paint(moment.viewpoint, moment.pose, with_geometry=True)
    assert frame.position is not None
    hidden = disoccluded(on.tracer, drawn_from, frame.field, moment.pose, frame.position)
    return frame.position, hidden
