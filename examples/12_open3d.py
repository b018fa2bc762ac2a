"""The panel's rays in Open3D: what each display pixel shows of a scene, and how far away it is."""

import numpy as np

import wlr_render as wlr
from wlr_render.engine import script_needs, world_positions
from wlr_render.files import write_png

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
    eye = wlr.open_eye("northstar", "right")  # or your model.json
    origin, direction, status = wlr.world_rays(eye)
    scene = wlr.load_scene("desk")
    distance, number = ray_caster(scene)(origin, direction)
    hit = np.isfinite(distance)
    print(f"{hit.mean():.1%} of {len(hit)} rays hit, from {distance[hit].min():.3f} m to {distance[hit].max():.3f} m")
    print("the middle pixel shows:", scene.instances[number.reshape(status.shape)[800, 720]].name)
    shade = np.where(hit, 255 * np.exp(-np.where(hit, distance, 0)), 0)
    write_png("distance.png", shade.astype(np.uint8).reshape(status.shape))
