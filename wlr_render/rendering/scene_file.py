"""Scenes as TOML files, by name or by path, and mesh files as scenes of their own. scenes/README.md has the keys."""

import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render import files
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.rendering.mesh_file import SUFFIXES, load_meshes
from wlr_render.rendering.scene import Instance, LightSource, Mesh, Scene
from wlr_render.rendering.shapes.construction import turn
from wlr_render.rendering.shapes.objects import SHAPES
from wlr_render.toml_files import Table, read_toml

FORMAT, VERSION, FRAME = "wlr-scene", 1, "openxr"
_PLACEMENT = ("name", "mesh", "shape", "position_m", "rotation_deg", "quaternion_xyzw", "scale", "scale_xyz")
_DEFAULT_LIGHTS = (
    LightSource("directional", normalised(np.array([0.4, -0.8, -0.6])), np.array([0.75, 0.73, 0.7], np.float32)),
    LightSource("directional", normalised(np.array([-0.7, -0.1, -0.5])), np.array([0.2, 0.22, 0.25], np.float32)),
)
_DEFAULT_DISTANCE_M = 1.0

Placed = tuple[tuple[Mesh, ...], tuple[Instance, ...], tuple[LightSource, ...]]


def scene_path(spec: str | Path) -> Path:
    """Path of a scene file or mesh file, given a shipped scene's name or a path.

    Raises:
        BadInputError: there is no such scene.
    """
    return Path(spec) if Path(spec).suffix.lower() in SUFFIXES else files.named_or_path("scenes", spec)


def load_scene(spec: str | Path) -> Scene:
    """A shipped scene by name, a scene file by path, or a mesh file by path.

    A mesh file becomes a scene with its content centred 1 m straight ahead of the world's origin, and with the file's
    lights or, where it has none, two directional ones.

    Raises:
        BadInputError: no such scene; a missing, unknown or faulty key; a fault in a mesh file.
    """
    path = scene_path(spec)
    if path.suffix.lower() in SUFFIXES:
        return _scene_of_mesh_file(path)
    table = read_toml(path)
    _require_header(table)
    scene = Scene(
        path.stem,
        (),
        (),
        tuple(_light(light) for light in table.tables("light", required=False)),
        ambient=table.vector("ambient", 3, default=(0.25, 0.25, 0.25)).astype(np.float32),
        background=table.vector("background", 3, default=(0.0, 0.0, 0.0)).astype(np.float32),
    )
    for entry in table.tables("object"):
        scene = _with(scene, _object(entry, path.parent))
    table.finish()
    return scene


def _require_header(table: Table) -> None:
    table.text("format", choices=(FORMAT,))
    table.text("frame", choices=(FRAME,))
    version = table.number("version")
    if version != VERSION:
        raise table.fail(f"'version' is {version:g}; this program reads version {VERSION}.")


def _with(scene: Scene, placed: Placed) -> Scene:
    """The scene and one more object; its instances' mesh indices are shifted."""
    meshes, instances, lights = placed
    shifted = tuple(replace(instance, mesh=instance.mesh + len(scene.meshes)) for instance in instances)
    return replace(
        scene,
        meshes=scene.meshes + meshes,
        instances=scene.instances + shifted,
        lights=scene.lights + lights,
    )


def _light(table: Table) -> LightSource:
    kind = table.text("kind", choices=("directional", "point"))
    if kind == "directional":
        vector = table.vector("direction", 3)
        if not np.linalg.norm(vector) > 0:
            raise table.fail("'direction' has no length.")
        vector = normalised(vector)
    else:
        vector = table.vector("position_m", 3)
    light = LightSource(kind, vector, table.vector("colour", 3).astype(np.float32))
    table.finish()
    return light


def _object(table: Table, folder: Path) -> Placed:
    """A shape or a mesh file, placed."""
    if table.has("mesh") == table.has("shape"):
        raise table.fail("needs either 'mesh', a file, or 'shape', one of the built-in ones.")
    world_from_object = _placement(table)
    if table.has("mesh"):
        return _mesh_object(table, folder, world_from_object)
    shape = table.text("shape", choices=sorted(SHAPES))
    name = table.text("name", default=shape)
    mesh = _shape(table, shape)
    table.finish()
    return (mesh,), (Instance(name, 0, world_from_object),), ()


def _mesh_object(table: Table, folder: Path, world_from_object: NDArray[np.float64]) -> Placed:
    path = folder / table.text("mesh")
    name = table.text("name", default=path.stem)
    table.finish()
    content = load_meshes(path)
    instances = tuple(
        Instance(f"{name}/{instance.name}", instance.mesh, world_from_object @ instance.world_from_mesh)
        for instance in content.instances
    )
    return content.meshes, instances, tuple(_moved(light, world_from_object) for light in content.lights)


def _moved(light: LightSource, world_from_object: NDArray[np.float64]) -> LightSource:
    if light.kind == "point":
        return replace(light, vector=transforms.apply(world_from_object, light.vector))
    return replace(light, vector=normalised(world_from_object[:3, :3] @ light.vector))


def _placement(table: Table) -> NDArray[np.float64]:
    """(4, 4) world_from_object: scale, then rotation, then translation."""
    if table.has("rotation_deg") and table.has("quaternion_xyzw"):
        raise table.fail("has both 'rotation_deg' and 'quaternion_xyzw'; keep one.")
    if table.has("scale") and table.has("scale_xyz"):
        raise table.fail("has both 'scale' and 'scale_xyz'; keep one.")
    if table.has("quaternion_xyzw"):
        xyzw = table.vector("quaternion_xyzw", 4)
        if abs(np.linalg.norm(xyzw) - 1) > 1e-3:
            raise table.fail(f"'quaternion_xyzw' has length {np.linalg.norm(xyzw):.6g}, not 1.")
        rotation = transforms.rotation_of_quaternion(normalised(xyzw))
    else:
        rotation = turn(*np.deg2rad(table.vector("rotation_deg", 3, default=(0.0, 0.0, 0.0))))
    uniform = table.number("scale", default=1.0)
    scale = table.vector("scale_xyz", 3, default=(uniform, uniform, uniform))
    if not (scale > 0).all():
        raise table.fail(f"a scale must be positive, not {scale.tolist()}.")
    return transforms.rigid(rotation * scale, table.vector("position_m", 3, default=(0.0, 0.0, 0.0)))


def _shape(table: Table, shape: str) -> Mesh:
    """Call a shape's function; its keyword arguments are the table's keys, each read as its default's type."""
    make = SHAPES[shape]
    parameters = inspect.signature(make).parameters
    present = table.keys()
    unknown = [key for key in present if key not in parameters and key not in _PLACEMENT]
    if unknown:
        raise table.fail(f"unknown key '{unknown[0]}'; the shape '{shape}' has {', '.join(parameters)}.")
    mesh = make(**{key: _value(table, key, parameters[key].default) for key in present if key in parameters})
    if len(mesh.triangles) == 0 or not mesh.normal.any(axis=1).all():
        raise table.fail(f"these keys make a '{shape}' without a surface; give it more segments or a size.")
    return mesh


def _value(table: Table, key: str, default: object) -> object:
    """A key's value, of the type of the default; sizes and counts must be positive, or 0 where the default is 0."""
    if isinstance(default, tuple):
        vector = table.vector(key, len(default))
        if (vector < 0).any():
            raise table.fail(f"'{key}' must not be negative, not {vector.tolist()}.")
        return tuple(vector.tolist())
    number = table.number(key)
    if number < 0 or (number == 0 and default != 0):
        raise table.fail(f"'{key}' must be positive, not {number:g}.")
    if isinstance(default, int) and number != int(number):
        raise table.fail(f"'{key}' must be a whole number, not {number:g}.")
    return int(number) if isinstance(default, int) else number


def _scene_of_mesh_file(path: Path) -> Scene:
    content = load_meshes(path)
    scene = Scene(path.stem, content.meshes, content.instances, ())
    if not content.instances:
        raise BadInputError(f"{path}: places none of its meshes in a scene; export the scene, not the meshes alone.")
    ahead = np.array([0.0, 0.0, -_DEFAULT_DISTANCE_M])
    world_from_file = transforms.rigid(np.eye(3), ahead - scene.bounds.mean(axis=0))
    instances = tuple(
        replace(instance, world_from_mesh=world_from_file @ instance.world_from_mesh) for instance in content.instances
    )
    lights = tuple(_moved(light, world_from_file) for light in content.lights)
    return replace(scene, instances=instances, lights=lights or _DEFAULT_LIGHTS)
