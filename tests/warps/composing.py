"""Small headsets, a small scene, and what drives a compositor as an engine does."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import gl_scenes
import moderngl
import numpy as np
import pytest
from fitted_eyes import fitted_eye
from present import present

from benchmarks.raster.disocclusion import disoccluded
from benchmarks.raster.raster_error import raster_error
from benchmarks.scene_source import SceneSource
from benchmarks.speed.accuracy import near_silhouettes
from wlr_render.draw.painters import position_of_source, with_inverse_depth
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.scene.scene import Scene
from wlr_render.scene.shapes import construction
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.frame_handle import FrameHandle
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import RayMap, middle_axes, solve_pixels

CONTEXTS = [pytest.param("egl", marks=pytest.mark.gl), pytest.param("osmesa", marks=pytest.mark.gl)]
HEAD = gl_scenes.at(0.2, 1.4, 0.5, transforms.rotation_about("y", 0.3) @ transforms.rotation_about("x", -0.1))
SMALL = 72, 60
Make = Callable[..., Any]
"""Makes compositors: the fixture `compositor`."""


def scene(wall: bool = True) -> Scene:
    """Boxes at 0.7 and 1.2 m before a wall that fills the field at 2 m, around where the head looks."""
    turn = transforms.rotation_about("y", 0.5)
    behind = ((construction.plane(9, 9, (0.2, 0.5, 0.3)), HEAD @ gl_scenes.at(0, 0, -2)),)
    return gl_scenes.lit(
        (gl_scenes.cube(0.15), HEAD @ gl_scenes.at(0.06, -0.03, -0.7, turn)),
        (gl_scenes.cube(0.3), HEAD @ gl_scenes.at(-0.2, 0.02, -1.2)),
        *(behind if wall else ()),
    )


def planar(eye: str = "right", device: str = "northstar") -> Eye:
    """A fitted eye of a device file: planar models."""
    return replace(fitted_eye(device, 3), eye=eye)


def viewpoint(mappings: Eye, *unit: float) -> FloatArray:
    """By box coordinates -1..1."""
    return mappings.eye_box.at(np.array(unit or (0.6, -0.5, 0.4)))


@dataclass(frozen=True, eq=False)
class Traced:
    """What the exact rays of each pixel of a display picture meet."""

    colour: np.ndarray
    position: np.ndarray
    ray_map: RayMap


def traced(
    mappings: Eye, size: tuple[int, int], at_viewpoint: FloatArray, pose: FloatArray, renderer: RayRenderer
) -> Traced:
    axes = middle_axes(mappings)
    solved = solve_pixels(mappings, axes, WarpGrid.of_pixels(mappings.display.panel, size).panel_pixel(), at_viewpoint)
    field = RayMap(at_viewpoint, axes, np.moveaxis(solved.slope_offset, -1, 0).astype(np.float32), solved.status)
    image = renderer.render_blocks(field.shape, lambda rows: field.world_rays(pose, rows), with_position=True)
    return Traced(image.colour, present(image.position), field)


def clear_of_edges(
    truth: Traced,
    renderer: RayRenderer,
    eye_in_world: FloatArray,
    drawn_from: FloatArray,
    pose: FloatArray,
    reach_px: int = 2,
) -> BoolArray:
    """Pixels that are neither near a silhouette nor near what a picture drawn from a place cannot show."""
    hidden = disoccluded(renderer.tracer, drawn_from, truth.ray_map, pose, truth.position).astype(np.uint8)
    near_hidden = cv2.dilate(hidden, np.ones((2 * reach_px + 1,) * 2, np.uint8)) > 0
    return np.asarray(~(near_hidden | near_silhouettes(truth.position, eye_in_world, reach_px)))


def draw(
    compositor: Compositor, source: SceneSource, pose: FloatArray, viewpoints: FloatArray | Mapping[str, FloatArray]
) -> FrameHandle:
    """An engine's half of a frame."""
    cameras = compositor.begin_frame(pose, viewpoints)
    for camera in cameras.values():
        source.submit(camera)
    return cameras


def misplaced_arcmin(
    source: SceneSource,
    camera: EyeCamera,
    composed: ComposedFrame,
    truth: Traced,
    pose: FloatArray,
    at_viewpoint: FloatArray,
) -> FloatArray:
    """Angle at the eye between the world points that a composed frame and the ray-traced one show; with a pull map."""
    shown = position_of_source(camera.view, with_inverse_depth(source.read(camera.view), composed.source(camera.eye)))
    return raster_error(shown, truth.position, transforms.apply(pose, at_viewpoint)).registration_arcmin


def programs_compiled(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Shaders of each program that ModernGL compiles from now on."""
    compiled: list[dict[str, Any]] = []
    compile_program, compile_compute_shader = moderngl.Context.program, moderngl.Context.compute_shader

    def counted(context: moderngl.Context, **shaders: Any) -> moderngl.Program:
        compiled.append(shaders)
        return compile_program(context, **shaders)

    def counted_compute(context: moderngl.Context, source: str) -> moderngl.ComputeShader:
        compiled.append({"compute_shader": source})
        return compile_compute_shader(context, source)

    monkeypatch.setattr(moderngl.Context, "program", counted)
    monkeypatch.setattr(moderngl.Context, "compute_shader", counted_compute)
    return compiled
