"""Scenes as TOML files, by name or by path, and mesh files used as scenes. scenes/README.md has the keys."""

import inspect
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.io import atomic_files
from wlr_render.io.input_files import require_length, shown
from wlr_render.io.toml_files import Table, read_toml
from wlr_render.numerics.arrays import Float32Array
from wlr_render.scene.mesh_file import SUFFIXES, load_meshes
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene
from wlr_render.scene.shapes.construction import turn
from wlr_render.scene.shapes.objects import SHAPES

FORMAT, VERSION, FRAME = "wlr-scene", 1, "openxr"
_PLACEMENT = ("name", "mesh", "shape", "position_m", "rotation_deg", "quaternion_xyzw", "scale", "scale_xyz")
_DEFAULT_LIGHTS = (
    LightSource("directional", normalised(np.array([0.4, -0.8, -0.6])), np.array([0.75, 0.73, 0.7], np.float32)),
    LightSource("directional", normalised(np.array([-0.7, -0.1, -0.5])), np.array([0.2, 0.22, 0.25], np.float32)),
)
_DEFAULT_DISTANCE_M = 1.0
_FAR_M = 1000.0  # largest distance of an object or light from the world's origin
_SHAPE_M = 50.0
_MESH_ALONE_M = 30.0  # largest radius of a mesh file used as a scene, around its middle 1 m ahead of the wearer
_SCALES = 1e-6, 1e6
_MOST_DEGREES = 3600.0
_BRIGHTEST = 1e6
_EXPOSURES = 1e-9, 1e6
_MOST_OBJECTS = 1000
_MOST_LIGHTS = 100
_MOST_TRIANGLES = 20_000_000  # largest number of triangles over all placements
_MOST_SEGMENTS = 2000
_MOST_QUADS = 1_000_000  # largest number of quads per shape

Placed = tuple[tuple[Mesh, ...], tuple[Instance, ...], tuple[LightSource, ...], tuple[str, ...]]


def scene_path(spec: str | Path) -> Path:
    """Return the path of a scene file or mesh file, given a shipped scene's name or a path.

    Raises:
        BadInputError: the scene does not exist.
    """
    return Path(spec) if Path(spec).suffix.lower() in SUFFIXES else atomic_files.named_or_path("scenes", spec)


def load_scene(spec: str | Path) -> Scene:
    """Load a shipped scene by name, a scene file (.toml) by path, or a mesh file by path; metres, y up.

    A mesh file becomes a scene with its content centred 1 m straight ahead of the world's origin, and with the file's
    lights or, if it has none, two directional lights.

    Raises:
        BadInputError: no such scene; a missing, unknown or faulty key; a fault in a mesh file.
    """
    path = scene_path(spec)
    if path.suffix.lower() in SUFFIXES:
        return _scene_of_mesh_file(path)
    table = read_toml(path)
    table.check_head(FORMAT, VERSION)
    table.text("frame", choices=(FRAME,))
    scene = Scene(
        path.stem,
        (),
        (),
        tuple(_light(light) for light in table.tables("light", required=False, most=_MOST_LIGHTS)),
        ambient=_colour(table, "ambient", default=(0.25, 0.25, 0.25)),
        background=_colour(table, "background", default=(0.0, 0.0, 0.0)),
    )
    for entry in table.tables("object", most=_MOST_OBJECTS):
        first = len(scene.instances)
        scene = _with(scene, _object(entry, path.parent))
        _require_drawable(entry.where, scene, first)
    exposure = table.number("exposure", default=1.0, least=_EXPOSURES[0], most=_EXPOSURES[1])
    table.finish()
    if not scene.instances:
        raise table.fail("'object' is empty; give at least one object.")
    lights = [replace(light, colour=np.float32(exposure) * light.colour) for light in scene.lights]
    return replace(scene, lights=tuple(lights))


def _with(scene: Scene, placed: Placed) -> Scene:
    """Return the scene with one more object; its instances' mesh indices are shifted."""
    meshes, instances, lights, not_drawn = placed
    shifted = tuple(replace(instance, mesh=instance.mesh + len(scene.meshes)) for instance in instances)
    return replace(
        scene,
        meshes=scene.meshes + meshes,
        instances=scene.instances + shifted,
        lights=scene.lights + lights,
        not_drawn=tuple(dict.fromkeys(scene.not_drawn + not_drawn)),  # a file may be placed several times
    )


def _require_drawable(where: str, scene: Scene, first: int = 0) -> None:
    """Refuse too many triangles, and instances from the `first` on that do not lie in the world."""
    if scene.triangle_count > _MOST_TRIANGLES:
        raise BadInputError(f"{where}: brings the scene to more than {_MOST_TRIANGLES} triangles; simplify it.")
    for instance in scene.instances[first:]:
        corners = scene.mesh_of(instance).corners @ instance.world_from_mesh[:3, :3].T + instance.world_from_mesh[:3, 3]
        require_length(f"{where} ({shown(instance.name)} in the world)", corners, _FAR_M)


def _colour(table: Table, key: str, default: tuple[float, float, float] | None = None) -> Float32Array:
    return table.vector(key, 3, default, least=0, most=_BRIGHTEST).astype(np.float32)


def _position(table: Table, default: tuple[float, float, float] | None = None) -> NDArray[np.float64]:
    position = table.vector("position_m", 3, default)
    require_length(f"{table.where}: 'position_m'", position, _FAR_M)
    return position


def _light(table: Table) -> LightSource:
    kind = table.text("kind", choices=("directional", "point"))
    if kind == "directional":
        vector = table.vector("direction", 3)
        if not np.linalg.norm(vector) > 0:
            raise table.fail("'direction' has no length; give three numbers that are not all 0.")
        vector = normalised(vector)
    else:
        vector = _position(table)
    light = LightSource(kind, vector, _colour(table, "colour"), table.where)
    table.finish()
    return light


def _object(table: Table, folder: Path) -> Placed:
    """Return a shape or a mesh file with its placement."""
    if table.has("mesh") == table.has("shape"):
        raise table.fail("needs either 'mesh', a file, or 'shape', one of the built-in ones; write one of them.")
    world_from_object = _placement(table)
    if table.has("mesh"):
        return _mesh_object(table, folder, world_from_object)
    shape = table.text("shape", choices=sorted(SHAPES))
    name = table.text("name", default=shape)
    mesh = _shape(table, shape)
    table.finish()
    return (mesh,), (Instance(name, 0, world_from_object),), (), ()


def _mesh_object(table: Table, folder: Path, world_from_object: NDArray[np.float64]) -> Placed:
    path, stated = table.path("mesh", folder), shown(table.text("mesh"))
    name = table.text("name", default=path.stem)
    table.finish()
    if path.suffix.lower() not in SUFFIXES:
        raise table.fail(f"'mesh' is {stated}; it must be a file with {', '.join(SUFFIXES)}.")
    if not os.path.exists(path):
        raise table.fail(f"'mesh' is {stated}, and there is no such file; put it beside the scene.")
    content = load_meshes(path)
    instances = tuple(
        Instance(f"{name}/{instance.name}", instance.mesh, world_from_object @ instance.world_from_mesh)
        for instance in content.instances
    )
    lights = tuple(_moved(light, world_from_object) for light in content.lights)
    return content.meshes, instances, lights, content.not_drawn


def _moved(light: LightSource, world_from_object: NDArray[np.float64]) -> LightSource:
    if light.kind == "point":
        return replace(light, vector=transforms.apply(world_from_object, light.vector))
    return replace(light, vector=normalised(world_from_object[:3, :3] @ light.vector))


def _placement(table: Table) -> NDArray[np.float64]:
    """Return world_from_object (4, 4): scale, then rotation, then translation."""
    if table.has("rotation_deg") and table.has("quaternion_xyzw"):
        raise table.fail("has both 'rotation_deg' and 'quaternion_xyzw'; keep one.")
    if table.has("scale") and table.has("scale_xyz"):
        raise table.fail("has both 'scale' and 'scale_xyz'; keep one.")
    if table.has("quaternion_xyzw"):
        xyzw = table.vector("quaternion_xyzw", 4)
        if abs(np.linalg.norm(xyzw) - 1) > 1e-3:
            raise table.fail(f"'quaternion_xyzw' has length {np.linalg.norm(xyzw):.6g}, not 1; normalise it.")
        rotation = transforms.rotation_of_quaternion(normalised(xyzw))
    else:
        degrees = table.vector("rotation_deg", 3, (0.0, 0.0, 0.0), least=-_MOST_DEGREES, most=_MOST_DEGREES)
        rotation = turn(*np.deg2rad(degrees))
    least, most = _SCALES
    uniform = table.number("scale", 1.0, least, most)
    scale = table.vector("scale_xyz", 3, (uniform, uniform, uniform), least=least, most=most)
    return transforms.rigid(rotation * scale, _position(table, default=(0.0, 0.0, 0.0)))


def _shape(table: Table, shape: str) -> Mesh:
    """Call a shape's function; keyword arguments are the table's keys, each read as the type of its default."""
    make = SHAPES[shape]
    parameters = inspect.signature(make).parameters
    present = table.keys()
    unknown = [key for key in present if key not in parameters and key not in _PLACEMENT]
    if unknown:
        raise table.fail(f"unknown key '{unknown[0]}'; the shape '{shape}' has {', '.join(parameters)}.")
    values = {key: _value(table, key, parameters[key].default) for key in present if key in parameters}
    counts = {key: each.default for key, each in parameters.items()} | values
    parts = math.prod(count for count in counts.values() if isinstance(count, int))
    if parts > _MOST_QUADS:
        raise table.fail(f"asks for {parts} parts, more than {_MOST_QUADS}; lower its numbers.")
    try:
        with np.errstate(all="ignore"):  # the next check refuses overflows
            mesh = make(**values)
    except BadInputError as error:
        raise table.fail(str(error)) from error
    if not np.isfinite(mesh.position).all() or not np.isfinite(mesh.normal).all():
        raise table.fail(f"these keys make a '{shape}' that is not finite; change its sizes.")
    if len(mesh.triangles) == 0 or not mesh.normal.any(axis=1).all():
        raise table.fail(f"these keys make a '{shape}' without a surface; give it more segments or a size.")
    return mesh


def _value(table: Table, key: str, default: object) -> object:
    """Return a value of the type of the default; sizes and counts are above 0, or from 0 if the default is 0."""
    if isinstance(default, tuple):
        most = _SHAPE_M if key.endswith("_m") else _BRIGHTEST
        return tuple(table.vector(key, len(default), least=0, most=most).tolist())
    if isinstance(default, int):
        return table.whole(key, least=min(default, 1), most=_MOST_SEGMENTS)
    return table.number(key, least=0, most=_SHAPE_M) if default == 0 else table.number(key, above=0, most=_SHAPE_M)


def _scene_of_mesh_file(path: Path) -> Scene:
    content = load_meshes(path)
    scene = Scene(path.stem, content.meshes, content.instances, (), not_drawn=content.not_drawn)
    if not content.instances:
        raise BadInputError(f"{path}: places none of its meshes in a scene; export the scene, not the meshes alone.")
    ahead = np.array([0.0, 0.0, -_DEFAULT_DISTANCE_M])
    world_from_file = transforms.rigid(np.eye(3), ahead - scene.bounds.mean(axis=0))
    instances = tuple(
        replace(instance, world_from_mesh=world_from_file @ instance.world_from_mesh) for instance in content.instances
    )
    lights = tuple(_moved(light, world_from_file) for light in content.lights)
    placed = replace(scene, instances=instances)
    _require_drawable(str(path), placed)
    require_length(f"{path} (place it in a scene file with its 'scale' otherwise)", placed.bounds, _MESH_ALONE_M)
    return replace(scene, instances=instances, lights=lights or _DEFAULT_LIGHTS)
