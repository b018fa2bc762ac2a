"""The panel's rays in NVIDIA Warp, on a GPU or the CPU: your kernel gets the ray of each display pixel."""

import numpy as np

import wlr_render as wlr
from wlr_render.engine import script_needs, world_positions
from wlr_render.files import write_png

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
        # The triangle's plane is intersected again in 64 bits: grazing rays amplify the rounding of the 32-bit query.
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
    eye = wlr.open_eye("northstar", "right")  # or your model.json
    origin, direction, status = wlr.world_rays(eye)
    distance, normal = ray_caster(wlr.load_scene("desk"))(origin, direction)
    hit = np.isfinite(distance)
    print(f"{hit.mean():.1%} of {len(hit)} rays hit, from {distance[hit].min():.3f} m to {distance[hit].max():.3f} m")
    write_png("normals.png", (127.5 * (normal + 1)).astype(np.uint8).reshape(*status.shape, 3))
