"""The raster of the paper: whatever a pixel shows lies on that pixel's bent world ray, and its source shows it."""

import numpy as np
import pytest
from gl_scenes import at, lit
from present import present

from benchmarks.raster.mesh_painter import MeshWarpedPainter, source_of_position
from wlr_render.draw.painters import TracedPainter, position_of_source
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.geometry import transforms
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.scene.scene import Scene
from wlr_render.scene.shapes import construction

HEAD_POSE = at(0.1, 1.5, 0.3, transforms.rotation_about("y", 0.5) @ transforms.rotation_about("x", -0.1))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A beach ball 0.8 m and a wall 3 m before the device that fill its whole field."""
    wall, ball = construction.plane(9, 7, (0.3, 0.4, 0.5)), construction.ball(0.12)
    return lit((wall, HEAD_POSE @ at(0, 0, -3)), (ball, HEAD_POSE @ at(0.05, 0, -0.8)))


def test_its_map_is_that_of_the_traced_points_and_of_the_depth_image(
    flat_image_headset: Eye, scene: Scene, gl_context: GlContext
) -> None:
    viewpoint, renderer = flat_image_headset.eye_box.at(np.array([0.7, -0.9, 0.8])), RayRenderer(scene)
    raster = SceneRaster(gl_context, scene)
    painters = MeshWarpedPainter(flat_image_headset, raster, renderer), WarpedPainter(flat_image_headset, raster)
    mesh, depth = (each.paint(viewpoint, HEAD_POSE, with_geometry=True) for each in painters)
    traced = TracedPainter(flat_image_headset, renderer).paint(viewpoint, HEAD_POSE, with_geometry=True)
    np.testing.assert_array_equal(mesh.position, traced.position)
    assert mesh.source is not None
    np.testing.assert_allclose(position_of_source(present(mesh.view), mesh.source), present(mesh.position), atol=2e-5)
    np.testing.assert_allclose(
        source_of_position(present(depth.view), present(depth.position)), present(depth.source), atol=2e-3
    )
    # At the ball's rim as well: from where the rays come, the image hides nothing of what they meet.
    assert np.linalg.norm((present(depth.source) - mesh.source)[..., :2], axis=-1).max() < 0.01
