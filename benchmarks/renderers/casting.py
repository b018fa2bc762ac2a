"""Third-party renderers, as functions from rays to distances."""

import importlib.metadata
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from wlr_render.draw.mitsuba_frames import PathTracer
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.errors import BadInputError
from wlr_render.extras import installed_by
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.scene.scene import Scene, world_positions
from wlr_render.warp.ray_map import RayMap

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

Cast = Callable[[Float32Array, Float32Array], Float32Array]
"""Function from origins and directions (n, 3), without NaN, to distances (n,), infinite for a miss."""


@dataclass(frozen=True)
class Library:
    """A library that is compared with Embree.

    Attributes:
        module: name of the Python module.
        package: name of the pip package.
        caster: function of a scene that returns a function to cast rays.
    """

    module: str
    package: str
    caster: Callable[[Scene], Cast]

    @property
    def is_installed(self) -> bool:
        """True if Python finds the library, without importing it."""
        return find_spec(self.module) is not None

    @property
    def name(self) -> str:
        """Package and version."""
        return f"{self.package} {importlib.metadata.version(self.package)}"


def _mitsuba(scene: Scene) -> Cast:
    tracer = PathTracer(scene)
    return lambda origin, direction: tracer.intersect(origin, direction).distance


def _of_example(name: str) -> Callable[[Scene], Cast]:
    def caster(scene: Scene) -> Cast:
        cast = runpy.run_path(str(EXAMPLES / f"{name}.py"))["ray_caster"](scene)
        return lambda origin, direction: np.asarray(cast(origin, direction)[0])

    return caster


BESIDE_M = 1e-6
"""Half the width of a bundle of rays: four steps between neighbouring 32-bit coordinates at 3 m."""


def right_distances(scene: Scene, origin: Float32Array, direction: Float32Array) -> FloatArray:
    """Return distances (5, n), in 64 bits, to the surfaces that rays (n, 3) may hit; infinite for a miss.

    They are distances along the ray to the plane of the triangle that Embree hits, and to the planes of the triangles
    that it hits from four points shifted sideways by `BESIDE_M`. The five differ only for a ray that passes an edge so
    closely that 32-bit rounding decides which side it hits.
    """
    tracer = SceneTracer(scene)
    placed = [(scene.mesh_of(instance), instance) for instance in scene.instances]
    first = np.cumsum([0, *(len(mesh.triangles) for mesh, _ in placed)])
    corners = np.concatenate([world_positions(*each).astype(np.float32)[each[0].triangles] for each in placed])
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    across = np.cross(b - a, c - a)
    start, along = np.broadcast_arrays(origin.astype(np.float64), direction.astype(np.float64))
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    aside *= BESIDE_M / np.linalg.norm(aside, axis=1, keepdims=True)
    up = np.cross(along, aside)
    distance = np.full((5, len(along)), np.inf)
    for row, beside in zip(distance, (np.zeros(3), aside, -aside, up, -up), strict=True):
        hits = tracer.intersect(start + beside, direction)
        hit = hits.instance >= 0
        triangle = first[hits.instance[hit]] + hits.triangle[hit]
        to_plane = ((a[triangle] - start[hit]) * across[triangle]).sum(axis=1)
        row[hit] = to_plane / (along[hit] * across[triangle]).sum(axis=1)
    return distance


LIBRARIES = (
    Library("mitsuba", "mitsuba", _mitsuba),
    Library("open3d", "open3d", _of_example("12_open3d")),
    Library("warp", "warp-lang", _of_example("13_warp")),
    Library("newton", "newton", _of_example("14_newton")),
)

_IN_BLENDER = """
import runpy, sys
import bpy
import numpy as np
from wlr_render.warp.ray_map import RayMap
from wlr_render.scene.scene_file import load_scene

example, scene, folder = runpy.run_path(sys.argv[1]), load_scene(sys.argv[2]), sys.argv[3]
stored = np.load(folder + "/rays.npz")
rays = RayMap(stored["viewpoint"], stored["axes"], stored["slope_offset"], stored["status"])
bpy.ops.wm.read_factory_settings(use_empty=True)
example["add_objects"](scene)
example["add_camera"](rays, stored["pose"], folder, "closest")
blender = bpy.context.scene
blender.view_layers[0].use_pass_position, blender.cycles.samples, blender.cycles.use_denoising = True, 1, False
image = blender.render.image_settings
image.media_type, image.file_format, image.color_depth = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER", "32"
blender.render.filepath = folder + "/passes.exr"
bpy.ops.render.render(write_still=True)
"""


def blender_positions(rays: RayMap, world_from_device: FloatArray, scene: str) -> Float32Array:
    """Return world points (n, 3) that the rays hit in Blender's Cycles, in a separate process; 0 for a miss.

    Raises:
        BadInputError: Blender ends with an error.
        MissingExtraError: the library OpenEXR is not installed.
    """
    with installed_by("exr", "Passes of Blender"):
        import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        np.savez(
            Path(folder, "rays.npz"),
            viewpoint=rays.viewpoint_in_device,
            axes=rays.device_from_camera,
            slope_offset=rays.slope_offset,
            status=rays.status,
            pose=world_from_device,
        )
        words = [sys.executable, "-c", _IN_BLENDER, str(EXAMPLES / "15_blender.py"), scene, folder]
        ran = subprocess.run(words, capture_output=True, text=True)
        if ran.returncode != 0:
            raise BadInputError(f"Blender ended with an error; its last lines: {ran.stderr[-500:]}")
        parts = OpenEXR.File(str(Path(folder, "passes.exr")), separate_channels=True).parts
        channels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    axes = [channels[f"ViewLayer.Position.{axis}"] for axis in "XYZ"]
    return np.stack(axes, axis=-1).reshape(-1, 3).astype(np.float32)
