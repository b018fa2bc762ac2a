"""The panel's rays in NVIDIA Warp, on a GPU or the CPU: a kernel of your own with the ray of each display pixel."""

import numpy as np

from wlr_render.extras import script_needs
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.image_files import write_png
from wlr_render.rendering.ray_map import choose_plan, ray_map
from wlr_render.rendering.scene import world_positions
from wlr_render.rendering.scene_file import load_scene

with script_needs("warp"):
    import warp

FARTHEST_M = 1e6


@warp.kernel
def nearest(
    mesh: warp.uint64,
    origin: warp.array(dtype=warp.vec3),
    direction: warp.array(dtype=warp.vec3),
    distance: warp.array(dtype=float),
    normal: warp.array(dtype=warp.vec3),
):
    ray = warp.tid()
    found = warp.mesh_query_ray(mesh, origin[ray], direction[ray], FARTHEST_M)
    if found.result:
        # The triangle's plane again, in 64 bits: those of the query are 32, whose rounding grazing rays multiply.
        a = warp.vec3d(warp.mesh_get_point(mesh, 3 * found.face))
        b = warp.vec3d(warp.mesh_get_point(mesh, 3 * found.face + 1))
        c = warp.vec3d(warp.mesh_get_point(mesh, 3 * found.face + 2))
        across = warp.cross(b - a, c - a)
        along = warp.dot(a - warp.vec3d(origin[ray]), across) / warp.dot(warp.vec3d(direction[ray]), across)
        distance[ray] = float(along)
        normal[ray] = found.normal


def ray_caster(scene):
    """A function of origins and directions (n, 3): distance (n,), infinite for a miss, and normal (n, 3)."""
    placed = [(scene.mesh_of(instance), instance) for instance in scene.instances]
    first_vertex = np.cumsum([0, *(len(mesh.position) for mesh, _ in placed)])
    corners = [mesh.triangles + first for (mesh, _), first in zip(placed, first_vertex, strict=False)]
    mesh = warp.Mesh(
        warp.array(np.concatenate([world_positions(*each) for each in placed]), dtype=warp.vec3),
        warp.array(np.concatenate(corners).ravel(), dtype=int),
    )

    def cast(origin, direction):
        rays = [warp.array(each, dtype=warp.vec3) for each in (origin, direction)]
        distance = warp.full(len(direction), float("inf"), dtype=float)
        normal = warp.zeros(len(direction), dtype=warp.vec3)
        warp.launch(nearest, len(direction), [mesh.id, *rays], [distance, normal])
        return distance.numpy(), normal.numpy()

    return cast


if __name__ == "__main__":
    eye = traced_eye(load_device("northstar"), "right")  # or models.model_file.load_eye_model("model.json").mappings
    rays = ray_map(eye, eye.eye_box.centre, choose_plan(eye))
    distance, normal = ray_caster(load_scene("desk"))(*rays.world_rays(np.eye(4)))
    hit = np.isfinite(distance)
    print(f"{hit.mean():.1%} of {len(hit)} rays hit, from {distance[hit].min():.3f} m to {distance[hit].max():.3f} m")
    write_png("normals.png", (127.5 * (normal + 1)).astype(np.uint8).reshape(*rays.shape, 3))
