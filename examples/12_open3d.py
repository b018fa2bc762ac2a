"""The panel's rays in Open3D: what each display pixel shows of a scene, and how far away it is."""

import numpy as np

from wlr_render.extras import script_needs
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.image_files import write_png
from wlr_render.rendering.ray_map import choose_plan, ray_map
from wlr_render.rendering.scene import world_positions
from wlr_render.rendering.scene_file import load_scene

with script_needs("open3d"):
    import open3d


def ray_caster(scene):
    """A function of origins and directions (n, 3): distance (n,), infinite for a miss, and number of the object."""
    world = open3d.t.geometry.RaycastingScene()
    for instance in scene.instances:
        mesh = scene.mesh_of(instance)
        world.add_triangles(world_positions(mesh, instance).astype(np.float32), mesh.triangles)

    def cast(origin, direction):
        found = world.cast_rays(np.concatenate([origin, direction], axis=1))
        return found["t_hit"].numpy(), found["geometry_ids"].numpy()

    return cast


if __name__ == "__main__":
    eye = traced_eye(load_device("northstar"), "right")  # or models.model_file.load_eye_model("model.json").mappings
    rays = ray_map(eye, eye.eye_box.centre, choose_plan(eye))
    scene = load_scene("desk")
    distance, number = ray_caster(scene)(*rays.world_rays(np.eye(4)))
    hit = np.isfinite(distance)
    print(f"{hit.mean():.1%} of {len(hit)} rays hit, from {distance[hit].min():.3f} m to {distance[hit].max():.3f} m")
    print("the middle pixel shows:", scene.instances[number.reshape(rays.shape)[800, 720]].name)
    shade = np.where(hit, 255 * np.exp(-np.where(hit, distance, 0)), 0)
    write_png("distance.png", shade.astype(np.uint8).reshape(rays.shape))
