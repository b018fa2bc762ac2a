from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gl_scenes import shipped_scene
from glb_writer import save_glb
from scene.test_mesh_file import gltf, obj

from wlr_render.draw.painters import saturation_warnings
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.io.atomic_files import shipped_names
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene import scene_file
from wlr_render.scene.scene import Instance, LightSource, Scene, world_positions
from wlr_render.scene.scene_file import load_scene
from wlr_render.scene.shapes import construction

HEADER = 'format = "wlr-scene"\nversion = 1\nframe = "openxr"\n'
BOX = '[[object]]\nshape = "box"\n'
EYE = np.array([0.032, 0.0, -0.03])


def scene_of(folder: Path, text: str) -> Scene:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


@pytest.fixture
def box_glb(tmp_path: Path) -> Path:
    """A box of 0.1 m at (5, 0, 0) under a lamp 0.5 m above its foot."""
    shifted = transforms.rigid(np.eye(3), np.array([5.0, 0, 0]))
    lamp = LightSource("point", np.array([5.0, 0.5, 0]), np.ones(3, np.float32))
    sun = LightSource("directional", np.array([0.0, -1, 0]), np.ones(3, np.float32))
    scene = Scene("box", (construction.box(),), (Instance("box", 0, shifted),), (lamp, sun))
    return save_glb(scene, tmp_path / "box.glb")


def tangents_of(scene: Scene, names: tuple[str, str]) -> FloatArray:
    """Tangents of all vertices of some objects as the eye sees them, (n, 2)."""
    points = [world_positions(scene.mesh_of(i), i) for i in scene.instances if i.name in names]
    offset = np.concatenate(points) - EYE
    return np.asarray(offset[:, :2] / -offset[:, 2:])


@pytest.mark.parametrize("name", shipped_names("scenes", ".toml"))
def test_shipped_scenes_load_and_lie_ahead_of_the_eye(name: str) -> None:
    scene = shipped_scene(name)
    assert scene.name == name
    assert scene.triangle_count > 0
    assert (scene.ambient > 0).all()
    centre = np.mean(scene.bounds, axis=0) - EYE
    assert centre[2] < -0.5


def test_the_sculpture_is_fine_and_lies_in_the_fields_of_the_devices() -> None:
    scene = shipped_scene("sculpture")
    assert scene.triangle_count >= 100_000
    angles = np.rad2deg(np.arctan(tangents_of(scene, ("sculpture", "stand/plinth"))))
    assert np.abs(angles[:, 0]).max() < 15
    assert angles[:, 1].min() > -25
    assert angles[:, 1].max() < 8


def test_the_objects_of_the_desk_reach_from_a_third_of_a_metre_to_three() -> None:
    scene = shipped_scene("desk")
    nearest = {
        i.name: np.linalg.norm(world_positions(scene.mesh_of(i), i) - EYE, axis=1).min() for i in scene.instances
    }
    assert nearest["things/mug"] < 0.35
    assert 1.5 < nearest["things/plant"] < 2
    assert nearest["things/picture"] > 2.9
    assert len(scene.instances) >= 15


def test_a_scene_file_is_read(tmp_path: Path) -> None:
    light = '[[light]]\nkind = "directional"\ndirection = [0, -2, 0]\ncolour = [1, 0.5, 0]\n'
    lamp = '[[light]]\nkind = "point"\nposition_m = [1, 2, 3]\ncolour = [0.1, 0.1, 0.1]\n'
    header = HEADER + "ambient = [0.1, 0.2, 0.3]\nbackground = [0.4, 0.5, 0.6]\n"
    item = BOX + 'name = "crate"\nsize_m = [0.1, 0.2, 0.4]\ncolour = [0.9, 0.8, 0.7]\nposition_m = [0, 0, -1]\n'
    scene = scene_of(tmp_path, header + light + lamp + item + '[[object]]\nshape = "sphere"\nsegments = 8\n')
    np.testing.assert_allclose(scene.ambient, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(scene.background, [0.4, 0.5, 0.6])
    np.testing.assert_allclose(scene.lights[0].vector, [0, -1, 0])
    np.testing.assert_allclose(scene.lights[1].vector, [1, 2, 3])
    assert [(i.name, i.mesh) for i in scene.instances] == [("crate", 0), ("sphere", 1)]
    np.testing.assert_allclose(scene.meshes[0].base_colour, [0.9, 0.8, 0.7])
    crate = world_positions(scene.meshes[0], scene.instances[0])
    np.testing.assert_allclose([crate.min(axis=0), crate.max(axis=0)], [[-0.05, 0, -1.2], [0.05, 0.2, -0.8]], atol=1e-7)


@pytest.mark.parametrize(
    ("keys", "point", "expected"),
    [
        ("rotation_deg = [0, 90, 0]", [0, 0, -1], [-1, 0, 0]),
        ("rotation_deg = [90, 90, 0]", [0, 0, -1], [0, 1, 0]),
        ("rotation_deg = [0, 90, 90]", [1, 0, 0], [0, 1, 0]),
        ("quaternion_xyzw = [0, 0, 0.6, 0.8]", [1, 0, 0], [0.28, 0.96, 0]),
        ("scale = 2\nrotation_deg = [0, 0, 90]", [1, 0, 0], [0, 2, 0]),
        ("scale_xyz = [2, 3, 4]\nrotation_deg = [0, 0, 90]", [1, 1, 1], [-3, 2, 4]),
        ("position_m = [1, 2, 3]\nscale = 2", [1, 0, 0], [3, 2, 3]),
    ],
)
def test_placement_scales_then_rotates_then_translates(
    tmp_path: Path, keys: str, point: Sequence[int], expected: Sequence[float]
) -> None:
    matrix = scene_of(tmp_path, HEADER + BOX + keys).instances[0].world_from_mesh
    np.testing.assert_allclose(transforms.apply(matrix, np.array(point, float)), expected, atol=1e-12)


def test_a_mesh_file_is_found_beside_the_scene_and_its_lights_move_along(tmp_path: Path, box_glb: Path) -> None:
    item = f'[[object]]\nmesh = "{box_glb.name}"\nposition_m = [-5, 1, 0]\nrotation_deg = [0, 0, 0]\n'
    turned = f'[[object]]\nname = "turned"\nmesh = "{box_glb.name}"\nrotation_deg = [0, 0, 90]\n'
    scene = scene_of(tmp_path, HEADER + item + turned)
    first, second = scene.instances
    np.testing.assert_allclose(first.world_from_mesh[:3, 3], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(second.world_from_mesh[:3, 3], [0, 5, 0], atol=1e-12)
    assert second.name.startswith("turned/")
    assert second.mesh == 1
    points = [light.vector for light in scene.lights if light.kind == "point"]
    np.testing.assert_allclose(points, [[0, 1.5, 0], [-0.5, 5, 0]], atol=1e-12)
    suns = [light.vector for light in scene.lights if light.kind == "directional"]
    np.testing.assert_allclose(suns, [[0, -1, 0], [1, 0, 0]], atol=1e-12)


def test_a_mesh_file_alone_is_a_scene_one_metre_ahead(tmp_path: Path, box_glb: Path) -> None:
    scene = load_scene(box_glb)
    np.testing.assert_allclose(scene.bounds.mean(axis=0), [0, 0, -1], atol=1e-7)
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), 0.1, atol=1e-7)
    lamp = next(light for light in scene.lights if light.kind == "point")
    np.testing.assert_allclose(lamp.vector, [0, 0.45, -1], atol=1e-7)
    dark = replace(scene, lights=())
    lit = load_scene(save_glb(dark, tmp_path / "dark.glb"))
    assert len(lit.lights) == 2


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('format = "wlr-scene"\nversion = 1\n' + BOX, "key 'frame' is missing"),
        (HEADER.replace("openxr", "opencv") + BOX, "'frame' is 'opencv'; it must be one of openxr"),
        (HEADER.replace("= 1", "= 2") + BOX, "has version 2; this program reads version 1"),
        (HEADER.replace("wlr-scene", "wlr-device") + BOX, "'format' is 'wlr-device'"),
        (HEADER, "key 'object' is missing"),
        (HEADER + "ambiant = [0, 0, 0]\n" + BOX, "unknown key 'ambiant'; did you mean 'ambient'?"),
        (HEADER + BOX + "radius = 1\n", "number 1: unknown key 'radius'; the shape 'box' has size_m, colour"),
        (HEADER + "[[object]]\nshape = 'teapot'\n", "'shape' is 'teapot'; it must be one of ball, box"),
        (HEADER + "[[object]]\nname = 'x'\n", "needs either 'mesh', a file, or 'shape'"),
        (HEADER + BOX + "mesh = 'x.glb'\n", "needs either 'mesh', a file, or 'shape'"),
        (HEADER + "[[object]]\nmesh = 'gone.glb'\n", "number 1: 'mesh' is 'gone.glb', and there is no such file"),
        (HEADER + "[[object]]\nmesh = ''\n", "number 1: 'mesh' is ''; it must be a file with .glb"),
        (HEADER + "object = []\n", "'object' is empty"),
        (HEADER + BOX + "rotation_deg = [1e17, 0, 0]\n", "'rotation_deg' has the value 1e+17"),
        (HEADER + "[[object]]\nmesh = 'gone.glb'\nsize_m = [1, 1, 1]\n", "unknown key 'size_m'"),
        (HEADER + BOX + "size_m = [1, 1]\n", "'size_m' must be a list of 3 numbers"),
        (HEADER + BOX + "size_m = [1, 1, -1]\n", "'size_m' has the value -1; it must be 0 or more"),
        (HEADER + "[[object]]\nshape = 'sphere'\nradius_m = 0\n", "'radius_m' has the value 0; it must be above 0"),
        (HEADER + "[[object]]\nshape = 'sphere'\nsegments = 7.5\n", "'segments' must be a whole number"),
        (HEADER + "[[object]]\nshape = 'sphere'\nsegments = 1\n", "make a 'sphere' without a surface"),
        (HEADER + "[[object]]\nshape = 'sculpture'\naround = 2\nalong = 2\n", "make a 'sculpture' without a surface"),
        (HEADER + BOX + "size_m = [0, 0, 1]\n", "make a 'box' without a surface"),
        (HEADER + BOX + "scale = 0\n", "'scale' has the value 0; it must be 1e-06 or more"),
        (HEADER + BOX + "scale = 1\nscale_xyz = [1, 1, 1]\n", "has both 'scale' and 'scale_xyz'"),
        (HEADER + BOX + "rotation_deg = [0, 0, 0]\nquaternion_xyzw = [0, 0, 0, 1]\n", "has both 'rotation_deg'"),
        (HEADER + BOX + "quaternion_xyzw = [0, 0, 0, 2]\n", "'quaternion_xyzw' has length 2"),
        (HEADER + BOX + "scale = 1e9\n", "'scale' has the value 1e+09; it must be 1e-06 or more, and at most 1e+06"),
        (
            HEADER + BOX + "size_m = [200, 30, 170]\n",
            "'size_m' has the value 200; it must be 0 or more, and at most 50",
        ),
        (HEADER + BOX + "position_m = [0, 0, -1500]\n", "'position_m' has a length of 1500 m"),
        (HEADER + BOX + "scale = 5e4\n", "number 1 ('box' in the world) has a length of 5000 m"),
        (
            HEADER + BOX + "colour = [0, 0, 1e9]\n",
            "'colour' has the value 1e+09; it must be 0 or more, and at most 1e+06",
        ),
        (HEADER + "ambient = [0, 0, -1]\n" + BOX, "'ambient' has the value -1; it must be 0 or more"),
        (HEADER + "background = [0, 0, 1e17]\n" + BOX, "'background' has the value 1e+17; it must be 0 or more"),
        (
            HEADER + BOX + "[[light]]\nkind = 'point'\nposition_m = [0, 0, 0]\ncolour = [1, -1, 1]\n",
            "'colour' has the value -1; it must be 0 or more",
        ),
        (
            HEADER + "[[object]]\nshape = 'sphere'\nsegments = 1000000000\n",
            "'segments' must be a whole number from 1 to 2000, not 1e+09",
        ),
        (HEADER + "[[object]]\nshape = 'sculpture'\naround = 1999\nalong = 1999\n", "asks for 3996001 parts"),
        (HEADER + "[[object]]\nshape = 'dot_board'\ncolumns = 500\nrows = 500\n", "number 1: A dot board of 500 x 500"),
        (HEADER + 1001 * BOX, "'object' has 1001 entries; 1000 is the most"),
        (HEADER + "[[object]]\nmesh = '../gone.glb'\n", "number 1: 'mesh': '../gone.glb' leads out of the folder"),
        (HEADER + "[[object]]\nmesh = '/gone.glb'\n", "number 1: 'mesh': '/gone.glb' leads out of the folder"),
        (HEADER + BOX + "[[light]]\nkind = 'spot'\n", "[[light]] number 1: 'kind' is 'spot'"),
        (HEADER + BOX + "[[light]]\nkind = 'directional'\ndirection = [0, 0, 0]\n", "'direction' has no length"),
        (HEADER + BOX + "[[light]]\nkind = 'point'\nposition_m = [0, 0, 0]\ncolor = [1, 1, 1]\n", "found 'color' inst"),
    ],
)
def test_a_faulty_scene_is_refused_with_its_file(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(BadInputError, match=r"mine\.toml|gone\.glb") as caught:
        scene_of(tmp_path, text)
    assert complaint in str(caught.value)


def test_a_scene_of_too_many_triangles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_file, "_MOST_TRIANGLES", 20)
    with pytest.raises(BadInputError, match=r"number 2: brings the scene to more than 20 triangles"):
        scene_of(tmp_path, HEADER + BOX + BOX)


def test_an_unknown_name_lists_the_shipped_scenes() -> None:
    with pytest.raises(BadInputError, match=r"desk, dots, sculpture.*Did you mean sculpture"):
        load_scene("sculptur")


def test_materials_that_are_drawn_in_part_are_named_once_and_without_a_limit(tmp_path: Path, box_glb: Path) -> None:
    assert load_scene(box_glb).warnings == []
    parts = obj(tmp_path, mtl="newmtl m\nKd 0.5 0.25 1\nd 0.5\n", texture=False)
    placed = f"[[object]]\nmesh = '{parts.name}'\nposition_m = [0, 0, -2]\n"
    (sentence,) = scene_of(tmp_path, HEADER + 2 * placed).warnings
    assert sentence == "Surfaces are drawn matt and opaque by every method. Not drawn: d of 'm' in wedge.obj."
    assert load_scene(parts).warnings == [sentence]
    many = replace(load_scene(parts), not_drawn=tuple(f"alphaMode of 'glass {n}' in a.glb" for n in range(70)))
    assert all(each in many.warnings[0] for each in many.not_drawn)


def test_a_scene_file_numbers_the_instances_of_a_glb_in_the_order_of_its_nodes(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "name": name, "translation": [0, 0, -1]} for name in ("texbox", "ball", "pane")]
    path = gltf(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1, 2]}])
    placed = f"[[object]]\nmesh = '{path.name}'\n"
    names = [instance.name for instance in scene_of(tmp_path, HEADER + BOX + placed).instances]
    assert names[1:] == ["wedge/texbox", "wedge/ball", "wedge/pane"]
    assert [instance.name for instance in load_scene(path).instances] == ["texbox", "ball", "pane"]


def test_a_file_with_a_spot_light_alone_gets_the_lights_of_a_file_without_lights(tmp_path: Path) -> None:
    spot = {"KHR_lights_punctual": {"lights": [{"type": "spot"}]}}
    nodes = [{"mesh": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}]
    assert len(load_scene(gltf(tmp_path, nodes=nodes, extensions=spot)).lights) == 2


def lit(folder: Path, kind: str, intensity: float, **scene: Any) -> Path:
    """A scene file of a white box 1 m away from a light of glTF, and the mesh file that it places."""
    box = construction.box()
    place = np.array([0, 1.0, 0]) if kind == "point" else np.array([0, -1.0, 0])
    light = LightSource(kind, place + box.corners.mean(axis=0) * (kind == "point"), np.full(3, intensity / np.pi))
    save_glb(Scene("lit", (box,), (Instance("box", 0, np.eye(4)),), (light,)), folder / "lit.glb")
    keys = "".join(f"{key} = {value}\n" for key, value in scene.items())
    path = folder / "lit.toml"
    path.write_text(f'{HEADER}{keys}[[object]]\nmesh = "lit.glb"\n')
    return path


@pytest.mark.parametrize(("kind", "intensity"), [("directional", 683.0), ("point", 54351.4)])
def test_photometric_lights_are_named_and_scaled_by_exposure(tmp_path: Path, kind: str, intensity: float) -> None:
    scene = load_scene(lit(tmp_path, kind, intensity))
    ((name, brightness),) = scene.bright_lights().items()
    assert brightness == pytest.approx(intensity / np.pi, rel=1e-3)
    frame = np.zeros((10, 10, 3), np.uint8)
    frame[:6, :, 0] = 255
    (warning,) = saturation_warnings(scene, [frame])
    assert warning.startswith("60% of the pixels of a frame are saturated.")
    assert f"'{name}' ({brightness:.3g} times)" in warning
    assert saturation_warnings(scene, [np.zeros_like(frame)]) == []
    scaled = load_scene(lit(tmp_path, kind, intensity, exposure=1 / brightness))
    np.testing.assert_allclose(scaled.lights[0].colour, scene.lights[0].colour / brightness, rtol=1e-6)
    assert load_scene(lit(tmp_path, kind, intensity, exposure=0.9 / brightness)).bright_lights() == {}
    np.testing.assert_array_equal(scaled.ambient, scene.ambient)


def test_a_faulty_exposure_is_refused(tmp_path: Path) -> None:
    for value in ("0", "-1", "nan", "1e9"):
        with pytest.raises(BadInputError, match=r"lit.toml: 'exposure'"):
            load_scene(lit(tmp_path, "point", 1.0, exposure=value))
