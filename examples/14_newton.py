"""The panel's rays in a camera of the physics engine Newton: pictures and distances from a simulated world."""

import numpy as np

import wlr_render as wlr
from wlr_render.engine import script_needs, world_positions
from wlr_render.files import write_png

with script_needs("newton"):
    import newton
    import warp
    from newton.sensors import SensorCamera


class PanelCamera:
    """Sees the objects of a scene, which rest in a Newton model; bodies that move would be seen as well."""

    def __init__(self, scene):
        builder = newton.ModelBuilder()
        for instance in scene.instances:
            mesh = scene.mesh_of(instance)
            shape = newton.Mesh(world_positions(mesh, instance), mesh.triangles.ravel(), compute_inertia=False)
            builder.add_shape_mesh(-1, mesh=shape)
        self.model = builder.finalize()
        self.camera = SensorCamera(self.model)
        self.camera.create_default_light()

    def pictures(self, origin, direction):
        """Colour (height, width, 4) and distance (height, width), 0 for a miss, of rays (height, width, 3)."""
        rays = warp.array(np.stack([origin, direction], axis=-2)[:, :, None], dtype=warp.vec3)
        size = direction.shape[1::-1]
        colour, distance = self.camera.allocate_image_color(1, *size), self.camera.allocate_image_depth(1, *size)
        at_origin = warp.array([warp.transform_identity()], dtype=warp.transformf)  # the rays are in the world
        config = SensorCamera.RenderConfig(enable_backface_culling=False)
        self.camera.update(
            self.model.state(), at_origin, rays, color_image=colour, depth_image=distance, render_config=config
        )
        return colour.numpy().view(np.uint8).reshape(*direction.shape[:2], 4), distance.numpy()[0]


def ray_caster(scene):
    """A function of origins and directions (n, 3): distance (n,), infinite for a miss, and colour (n, 4)."""
    camera = PanelCamera(scene)

    def cast(origin, direction):
        colour, distance = camera.pictures(origin[None], direction[None])
        return np.where(distance[0] > 0, distance[0], np.inf), colour[0]

    return cast


if __name__ == "__main__":
    eye = wlr.open_eye("northstar", "right")  # or your model.json
    origin, direction, status = wlr.world_rays(eye)
    origin, direction = (each.reshape(*status.shape, 3) for each in (origin, direction))
    colour, distance = PanelCamera(wlr.load_scene("desk")).pictures(origin, direction)
    hit = distance > 0
    print(f"{hit.mean():.1%} of {hit.size} rays hit, from {distance[hit].min():.3f} m to {distance[hit].max():.3f} m")
    write_png("panel.png", np.ascontiguousarray(colour[..., :3]))
