"""Path-traced frames on the panel's own rays: the only module that imports Mitsuba 3.

Surfaces are matt on both sides, as in `shading.py`, which draws direct light only. Mitsuba's Lambert surface reflects
1/pi of the light and ours all of it, so Mitsuba gets lights that are pi times as strong. The ambient light is a sky of
one colour, which is partly hidden from corners and cracks, and which the background does not show. An albedo above 1 is
clipped to 1, because paths would gain light without end.

Mitsuba compiles for the processor with LLVM, which it loads as a shared library: the only variant that takes arrays of
rays without a GPU. An LLVM that is too old ends the whole process when the first path is compiled, so its version is
checked beforehand.
"""

import contextlib
import ctypes
import functools
import glob
import os
import re
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.draw.painters import Frame, by_colour, channels_of, ray_maps_between_pixels, ray_maps_of
from wlr_render.draw.ray_intersections import Intersections
from wlr_render.extras import MissingExtraError, installed_by
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene, world_normals, world_positions
from wlr_render.warp.ray_map import choose_plan

LEAST_LLVM = 19
"""Oldest LLVM that was tested; up to version 16 the process ends with "Cannot select: fminimum"."""
_USE = "Path tracing"
_VARIANT = "llvm_ad_rgb"
_LLVM_PATH = "DRJIT_LIBLLVM_PATH"
"""Environment variable in which Mitsuba's compiler looks for the file of LLVM."""
_LLVM_FILES = {
    "linux": (
        "/usr/lib/*/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
    ),
    "darwin": ("/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib", "/usr/local/opt/llvm*/lib/libLLVM*.dylib"),
    "win32": ("C:/Program Files/LLVM/bin/LLVM-C.dll",),
}
_BRDF_NORMALISATION = np.pi
_COLOUR = "vertex_colour"


class PathTracer:
    """Traces paths of light through one scene."""

    def __init__(self, scene: Scene, bounces: int = 4) -> None:
        """Prepare the scene.

        Args:
            scene: the surfaces and lights.
            bounces: reflections of light between surfaces that are followed; with 0 only light that comes straight
                from a light source, or from the sky, is reflected.

        Raises:
            MissingExtraError: Mitsuba is not installed, or no LLVM of version 19 or newer is found.
        """
        self.scene = scene
        with _mitsuba() as mi:
            shapes = [_shape(mi, scene.mesh_of(instance), instance) for instance in scene.instances]
            # Robust intersections, as in `SceneTracer`: no ray slips through between two triangles.
            parts = {f"shape{number}": shape for number, shape in enumerate(shapes)} | _lights(scene)
            self._scene = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, **parts})
            self._integrator = mi.load_dict({"type": "path", "max_depth": bounces + 2, "hide_emitters": True})
            self._sampler = mi.load_dict({"type": "independent"})
            numbers = [_registry_numbers(mi.ShapePtr(shape))[0] for shape in shapes]
        self._instance_of_number = np.full(max(numbers, default=0) + 1, -1, np.int32)
        self._instance_of_number[numbers] = np.arange(len(numbers))

    def intersect(self, origin: Float32Array, direction: Float32Array) -> Intersections:
        """Return the nearest intersection of each ray (n, 3), like `SceneTracer.intersect`.

        Mitsuba computes them: a frame's points are then exactly the starts of its paths, without a second tree of the
        scene, and a comparison with `SceneTracer` checks the scene that Mitsuba was given.
        """
        hits = Intersections.misses(len(direction))
        with _mitsuba() as mi:
            index, ray = _finite_rays(mi, origin, direction)
            found = self._scene.ray_intersect_preliminary(mi.Ray3f(ray), coherent=True)
            number = _registry_numbers(found.shape)
            is_hit = number > 0
            index = index[is_hit]
            hits.distance[index] = found.t.numpy()[is_hit]
            hits.instance[index] = self._instance_of_number[number[is_hit]]
            hits.triangle[index] = found.prim_index.numpy()[is_hit]
            hits.barycentric_u[index], hits.barycentric_v[index] = np.array(found.prim_uv)[:, is_hit]
        return hits

    def light(self, origin: Float32Array, direction: Float32Array, seed: int) -> Float32Array:
        """Return the light that one random path brings along each ray.

        Args:
            origin, direction: (n, 3) float32 world frame; rays with a NaN see the background.
            seed: 0 to 2^32 - 1; the same seed and rays give the same light, whatever the number of threads.

        Returns:
            (n, 3) float32 linear RGB, not clipped.
        """
        light = np.empty((len(direction), 3), np.float32)
        light[:] = self.scene.background
        with _mitsuba() as mi:
            index, ray = _finite_rays(mi, origin, direction)
            self._sampler.seed(seed, len(index))
            colour, is_hit, _ = self._integrator.sample(self._scene, self._sampler, ray, None, True)
            hit = is_hit.numpy()
            light[index[hit]] = np.array(colour).T[hit]
        return light


class PathTracedPainter:
    """A `Painter` of path-traced frames: paths start along the world ray of every display pixel."""

    def __init__(
        self,
        mappings: Eye | Sequence[Eye],
        tracer: PathTracer,
        samples: int = 64,
        seed: int | Sequence[int] = 0,
    ) -> None:
        """Prepare.

        Args:
            mappings: one pair for all colours, or one each for red, green and blue.
            tracer: path tracer of the scene.
            samples: paths per pixel, spread evenly over the pixel; geometry is always sampled at the pixel centre.
            seed: seed of the paths, one number or several; every frame has the same noise.
        """
        self._channels = channels_of(mappings)
        self._tracer = tracer
        self._plans = [choose_plan(each) for each in self._channels]
        self._offsets = _offsets_in_pixel(samples)
        self._seeds = np.random.SeedSequence(seed).generate_state(samples)

    def paint(self, viewpoint: FloatArray, world_from_device: FloatArray, with_geometry: bool = False) -> Frame:
        """Return a path-traced frame; see `Painter`."""
        ray_maps = ray_maps_of(self._channels, self._plans, viewpoint)
        colours, traced = [], []
        for mappings, plan, rays in zip(self._channels, self._plans, ray_maps, strict=True):
            shape = (*rays.shape, 3)
            if with_geometry:
                traced.append(self._positions(*rays.world_rays(world_from_device)).reshape(shape))
            total = np.zeros((shape[0] * shape[1], 3), np.float32)
            samples = ray_maps_between_pixels(mappings, plan, rays, self._offsets)
            for sample, seed in zip(samples, self._seeds, strict=True):
                total += self._tracer.light(*sample.world_rays(world_from_device), int(seed))
            colours.append(encode_srgb(total / np.float32(len(self._seeds))).reshape(shape))
        return Frame(functools.partial(by_colour, colours), lambda: ray_maps, traced=tuple(traced))

    def _positions(self, origin: Float32Array, direction: Float32Array) -> Float32Array:
        distance = self._tracer.intersect(origin, direction).distance
        return np.asarray(origin + np.where(np.isfinite(distance), distance, np.float32(np.nan))[:, None] * direction)


def _offsets_in_pixel(count: int) -> FloatArray:
    """Return Hammersley points of a pixel, (count, 2) in pixels from its centre, evenly spaced along both axes.

    The second coordinate is the rank of the bit-reversed number: the bit-reversed numbers themselves are evenly spaced
    about the centre only for powers of two. With any other mean the whole frame would be shifted.
    """
    number = np.arange(count)
    mirrored = np.zeros(count)
    for bit in range(count.bit_length()):
        mirrored += (number >> bit & 1) / 2.0 ** (bit + 1)
    rank = np.argsort(np.argsort(mirrored))
    return (np.stack([number, rank], axis=-1) + 0.5) / count - 0.5


def _finite_rays(mi: Any, origin: Float32Array, direction: Float32Array) -> tuple[Any, Any]:
    """Return the indices of the rays without NaN, and these rays in Mitsuba's type."""
    origin = np.broadcast_to(origin, direction.shape)
    index = np.flatnonzero(np.isfinite(origin).all(axis=1) & np.isfinite(direction).all(axis=1))
    start, towards = (np.ascontiguousarray(each[index].T, dtype=np.float32) for each in (origin, direction))
    return index, mi.RayDifferential3f(mi.Point3f(*start), mi.Vector3f(*towards))


def _registry_numbers(shape: Any) -> Any:
    """Return Mitsuba's registry numbers (n,) of shapes, 0 for no shape."""
    import drjit

    numbers: Any = drjit.reinterpret_array(drjit.uint32_array_t(type(shape)), shape)
    return numbers.numpy()


def _shape(mi: Any, mesh: Mesh, instance: Instance) -> Any:
    """Return an instance as a mesh in the world."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "twosided", "matt": {"type": "diffuse", "reflectance": _albedo(mi, mesh)}}
    )
    sizes = len(mesh.position), len(mesh.triangles)
    shape = mi.Mesh(
        instance.name, *sizes, has_vertex_normals=True, has_vertex_texcoords=mesh.uv is not None, props=properties
    )
    if mesh.vertex_colour is not None:
        colour = mesh.vertex_colour * mesh.base_colour
        shape.add_attribute(_COLOUR, 3, np.ravel(colour if mesh.texture is not None else np.minimum(colour, 1)))
    arrays = mi.traverse(shape)
    arrays["vertex_positions"] = np.ravel(world_positions(mesh, instance)).astype(np.float32)
    arrays["vertex_normals"] = np.ravel(world_normals(mesh, instance)).astype(np.float32)
    if mesh.uv is not None:
        arrays["vertex_texcoords"] = np.ravel(mesh.uv)
    arrays["faces"] = np.ravel(mesh.triangles)
    arrays.update()
    return shape


def _albedo(mi: Any, mesh: Mesh) -> Any:
    """Return base colour times texture times vertex colour, at most 1."""
    import drjit

    attribute = {"type": "mesh_attribute", "name": _COLOUR}
    if mesh.texture is None:
        plain = {"type": "rgb", "value": np.minimum(mesh.base_colour, 1).tolist()}
        return mi.load_dict(plain if mesh.vertex_colour is None else attribute)
    texels = decode_srgb(mesh.texture)
    if mesh.vertex_colour is None:
        return mi.load_dict(_texture(mi, np.minimum(texels * mesh.base_colour, 1)))
    texture, colour = mi.load_dict(_texture(mi, texels)), mi.load_dict(attribute)

    class Product(mi.Texture):  # type: ignore[misc]  # Mitsuba has no product texture
        def eval(self, surface: Any, active: Any = True) -> Any:
            return drjit.minimum(1, texture.eval(surface, active) * colour.eval(surface, active))

    return Product(mi.Properties())


def _texture(mi: Any, texels: Float32Array) -> dict[str, Any]:
    return {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True}


def _lights(scene: Scene) -> dict[str, Any]:
    lights: dict[str, Any] = {f"light{number}": _light(light) for number, light in enumerate(scene.lights)}
    if scene.ambient.any():
        lights["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": scene.ambient.tolist()}}
    return lights


def _light(light: LightSource) -> dict[str, Any]:
    strength = {"type": "rgb", "value": (_BRDF_NORMALISATION * light.colour).tolist()}
    if light.kind == "point":
        return {"type": "point", "position": light.vector.tolist(), "intensity": strength}
    return {"type": "directional", "direction": light.vector.tolist(), "irradiance": strength}


@contextlib.contextmanager
def _mitsuba() -> Iterator[Any]:
    """Yield Mitsuba with the variant that we use; restore the caller's variant at the end.

    Raises:
        MissingExtraError: Mitsuba is not installed or does not load, or no usable LLVM is installed.
    """
    if find_spec("mitsuba") is not None:
        _choose_llvm()
    with installed_by("mitsuba", _USE):
        import mitsuba

        before = mitsuba.variant()
        mitsuba.set_variant(_VARIANT)
    try:
        yield mitsuba
    finally:
        if before is not None:
            mitsuba.set_variant(before)


@functools.cache
def _choose_llvm() -> None:
    """Make Mitsuba load the LLVM that the environment variable names or, without it, the newest that is installed.

    Raises:
        MissingExtraError: no LLVM is installed, or it is too old.
    """
    named = os.environ.get(_LLVM_PATH)
    faults = []
    for path in [Path(named)] if named else sorted(_installed_llvm(), key=_version_in_path, reverse=True):
        version = _llvm_version(path)
        if version is not None and version >= LEAST_LLVM:
            os.environ[_LLVM_PATH] = str(path)
            return
        faults.append(f"{path} cannot be loaded" if version is None else f"{path} is older")
    fault = faults[0] if faults else "none is installed"
    raise MissingExtraError(
        f"{_USE}: Mitsuba needs LLVM {LEAST_LLVM} or newer, and {fault}; install it (Debian: apt-get install "
        f"libllvm{LEAST_LLVM}, macOS: brew install llvm), or set {_LLVM_PATH} to the path of its library."
    )


def _installed_llvm() -> list[Path]:
    patterns = (*_LLVM_FILES.get(sys.platform, ()), f"{sys.prefix}/lib/libLLVM*")  # the last pattern is for conda
    return [Path(path) for pattern in patterns for path in glob.glob(pattern)]


def _version_in_path(path: Path) -> tuple[int, ...]:
    """Return the numbers after "llvm" in a path: libLLVM-19.so, libLLVM.so.19.1, llvm@19/lib/libLLVM.dylib.

    Links are followed: Homebrew's opt/llvm leads to Cellar/llvm/21.1.0.
    """
    behind = re.split("llvm", str(path.resolve()), maxsplit=1, flags=re.IGNORECASE)[-1]
    return tuple(map(int, re.findall(r"\d+", behind)))


def _llvm_version(path: Path) -> int | None:
    """Return the major version of a library, 0 before 16 without LLVMGetVersion; None if it cannot be loaded."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError:
        return None
    numbers = [ctypes.c_uint() for _ in range(3)]
    try:
        library.LLVMGetVersion(*map(ctypes.byref, numbers))
    except AttributeError:
        return 0
    return numbers[0].value
