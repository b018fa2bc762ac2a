"""A camera for Blender's Cycles whose pixels have the panel's rays, for scenes and materials made in Blender.

Needs Python 3.11 and bpy, which is installed without its dependencies (docs/renderers.md).
"""

import tempfile
from pathlib import Path

import numpy as np

import wlr_render as wlr
from wlr_render.engine import choose_plan, ray_map, script_needs
from wlr_render.files import write_exr
from wlr_render.geometry import transforms

with script_needs("blender"):
    import bpy

# In the axes of Cycles' cameras: x right, y up, z forward. The file has NaN where a pixel has no ray.
SHADER = """
shader panel_camera(string ray_map = "", string between_pixels = "linear",
                    output point position = 0.0, output vector direction = 0.0, output color throughput = 1.0)
{
  point place = camera_shader_raster_position();
  float d = 0;
  color abc = texture(ray_map, place[0], 1 - place[1], 0, 0, 0, 0,
                      "interp", between_pixels, "wrap", "clamp", "alpha", d);
  if (isnan(abc[0]))
    throughput = 0;
  position = point(abc[2], d, 0);
  direction = normalize(vector(abc[0], abc[1], 1));
}
"""


def add_camera(rays, world_from_device, folder, between_pixels="linear"):
    """Give the scene a camera with the rays of a ray map; with "closest", all samples of a pixel use its centre's ray.

    The scene has the axes of the world frame, y up. The camera reads `folder`/ray_map.exr when it renders.
    """
    import _cycles  # part of bpy

    file = write_exr(Path(folder, "ray_map.exr").resolve(), dict(zip("RGBA", rays.slope_offset, strict=True)))
    scene, data = bpy.context.scene, bpy.data.cameras.new("panel")
    with tempfile.TemporaryDirectory() as temporary:
        source, compiled = Path(temporary, "panel_camera.osl"), Path(temporary, "panel_camera.oso")
        source.write_text(SHADER)
        _cycles.osl_compile(str(source), str(compiled))
        data.type, data.custom_bytecode, data.custom_bytecode_hash = "CUSTOM", compiled.read_text(), "panel_camera"
    data.cycles_custom["ray_map"], data.cycles_custom["between_pixels"] = str(file), between_pixels
    device_from_camera = transforms.rigid(rays.device_from_camera, rays.viewpoint_in_device)
    scene.camera = bpy.data.objects.new("panel", data)
    scene.camera.matrix_world = (world_from_device @ device_from_camera).T  # Blender takes columns
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.shading_system = "CYCLES", True
    scene.render.resolution_y, scene.render.resolution_x = rays.shape


def add_objects(scene):
    """Add the objects of a wlr_render scene in Blender's default grey; your .blend file brings its own materials."""
    for instance in scene.instances:
        mesh, data = scene.mesh_of(instance), bpy.data.meshes.new(instance.name)
        data.from_pydata(mesh.position, [], mesh.triangles)
        placed = bpy.data.objects.new(instance.name, data)
        placed.matrix_world = instance.world_from_mesh.T
        bpy.context.scene.collection.objects.link(placed)


def add_light(position, watts):
    lamp = bpy.data.lights.new("lamp", "POINT")
    lamp.energy, lamp.shadow_soft_size = watts, 0.1
    placed = bpy.data.objects.new("lamp", lamp)
    placed.location = position
    bpy.context.scene.collection.objects.link(placed)


if __name__ == "__main__":
    eye = wlr.open_eye("northstar", "right")  # or your model.json
    rays = ray_map(eye, eye.eye_box.centre, choose_plan(eye))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_objects(wlr.load_scene("desk"))
    add_light((-0.3, 0.5, -0.3), 30.0)
    add_camera(rays, np.eye(4), ".")
    render = bpy.context.scene.render
    render.filepath, bpy.context.scene.cycles.samples = str(Path("panel.png").resolve()), 4
    bpy.ops.render.render(write_still=True)
    print(f"panel.png: {render.resolution_x} x {render.resolution_y} pixels, {len(bpy.data.meshes)} meshes")
