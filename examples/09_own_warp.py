"""Warp in a renderer that is not OpenGL: a WebGPU program draws, and warps with the mesh and the shipped shader.

Needs the extra `wgpu` and a Vulkan, Metal or Direct3D device; lavapipe (mesa-vulkan-drivers) will do.
"""

import numpy as np

import wlr_render as wlr
from wlr_render.engine import DepthKind, script_needs
from wlr_render.files import resource, write_png
from wlr_render.geometry import transforms

with script_needs("wgpu"):
    import wgpu

SIZE, NEAR_M = (720, 800), 0.2
STORED = wlr.StoredDepth(DepthKind.WINDOW, NEAR_M, np.inf)

# The engine: cubes on a grid, whose sides blend from colour to colour.
SCENE = """
@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
struct Place { @builtin(position) position: vec4f, @location(0) place: vec3f }
const CUBE = array<u32, 36>(
    0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5);
@vertex fn vertex(@builtin(vertex_index) v: u32, @builtin(instance_index) i: u32) -> Place {
    let corner = vec3f(vec3u(CUBE[v], CUBE[v] >> 1, CUBE[v] >> 2) & vec3u(1)) - 0.5;
    let cell = vec3f(f32(i % 7) - 3, f32(i / 7 % 5) - 2, -2 - f32(i / 35));
    let place = 0.3 * cell + 0.1 * corner;
    return Place(clip_from_world * vec4f(place, 1), place);
}
@fragment fn fragment(at: Place) -> @location(0) vec4f { return vec4f(0.5 + 0.4 * sin(40 * at.place), 1); }"""

device = wgpu.gpu.request_adapter_sync().request_device_sync()


def buffer(values, usage):
    return device.create_buffer_with_data(data=np.ascontiguousarray(values), usage=usage)


def target(size, kind):
    usage = "RENDER_ATTACHMENT | TEXTURE_BINDING | COPY_SRC"
    return device.create_texture(size=(*size, 1), format=kind, usage=usage)


def read(texture, dtype):
    width, height, _ = texture.size
    values = device.queue.read_texture(
        {"texture": texture}, {"bytes_per_row": 4 * width, "rows_per_image": height}, texture.size
    )
    return np.frombuffer(values, dtype).reshape(height, width, -1)


def pipeline(module, stage, kind, layout="auto", buffers=(), **settings):
    return device.create_render_pipeline(
        layout=layout,
        vertex={"module": module, "entry_point": f"{stage}vertex", "buffers": buffers},
        fragment={"module": module, "entry_point": f"{stage}fragment", "targets": [{"format": kind}]},
        **settings,
    )


def bound(layout, *resources):
    entries = [{"binding": k, "resource": each} for k, each in enumerate(resources)]
    return device.create_bind_group(layout=layout, entries=entries)


def attributes(components, location):
    attribute = {"format": f"float32x{components}", "offset": 0, "shader_location": location}
    return {"array_stride": 4 * components, "attributes": [attribute]}


# Once: the mesh of the panel, textures and pipelines.
eye = wlr.open_eye("northstar")  # or your model.json
mesh = wlr.WarpMesh(eye, SIZE)
drawn_pose = transforms.rigid(transforms.rotation_about("y", 0.1), np.array([0.05, 0.0, 0.0]))
newest_pose = drawn_pose @ transforms.rigid(transforms.rotation_about("y", 0.005), np.array([0.004, 0.002, 0.0]))
pupil = eye.eye_box.at(np.array([0.5, -0.5, 0.0]))
camera = mesh.camera(drawn_pose, pupil)
picture, depth = target(camera.size_px, "rgba8unorm-srgb"), target(camera.size_px, "depth32float")
panel = target(SIZE, "rgba8unorm-srgb")
nearer = {"format": "depth32float", "depth_write_enabled": True, "depth_compare": "less"}
scene = pipeline(device.create_shader_module(code=SCENE), "", "rgba8unorm-srgb", depth_stencil=nearer)
exact, both = {"texture": {"sample_type": "unfilterable-float"}}, wgpu.ShaderStage.VERTEX | wgpu.ShaderStage.FRAGMENT
kinds = {"buffer": {}}, {"texture": {}}, exact, exact, {"sampler": {}}, {"sampler": {"type": "non-filtering"}}
entries = [{"binding": k, "visibility": both, **each} for k, each in enumerate(kinds)]
warp_bindings = device.create_bind_group_layout(entries=entries)
layout = device.create_pipeline_layout(bind_group_layouts=[warp_bindings])
module = device.create_shader_module(code=resource("shaders", "own_warp.wgsl").read_text(encoding="utf-8"))
to_tiles = pipeline(module, "tiles_", "rg32float", layout)
warp = pipeline(module, "", "rgba8unorm-srgb", layout, [attributes(2, 0), attributes(4, 1)])
tiles = target([-(-side // 8) for side in camera.size_px], "rg32float")
samplers = device.create_sampler(mag_filter="linear", min_filter="linear"), device.create_sampler()
panel_position = buffer(mesh.panel_position, "VERTEX")
triangles = buffer(mesh.triangles, "INDEX")

# Each frame: draw with the camera ...
encoder = device.create_command_encoder()
clip_from_world = camera.projection(NEAR_M, zero_to_one=True) @ camera.camera_from_world
cleared = {"load_op": "clear", "store_op": "store"}
draw = encoder.begin_render_pass(
    color_attachments=[{"view": picture.create_view(), **cleared}],
    depth_stencil_attachment={
        "view": depth.create_view(),
        "depth_clear_value": 1.0,
        "depth_load_op": "clear",
        "depth_store_op": "store",
    },
)
draw.set_pipeline(scene)
draw.set_bind_group(
    0, bound(scene.get_bind_group_layout(0), {"buffer": buffer(clip_from_world.T.astype(np.float32), "UNIFORM")})
)
draw.draw(36, 105)
draw.end()

# ... find the bounds of the depths in tiles of 8 x 8 pixels ...
given = np.zeros(28, np.float32)  # struct Warp of the shader
given[:12] = mesh.image_from_ray(camera, pupil, newest_pose).ravel()
given[12:16] = 2, -2, -1, 1
given[16:20] = *STORED.inverse_of_0_and_1, STORED.nothing, 1 / NEAR_M
given[23:25] = 1, mesh.samples_per_axis
uniforms, views = {"buffer": buffer(given, "UNIFORM")}, [each.create_view() for each in (picture, depth)]
draw = encoder.begin_render_pass(color_attachments=[{"view": tiles.create_view(), **cleared}])
draw.set_pipeline(to_tiles)
draw.set_bind_group(0, bound(warp_bindings, uniforms, *views, views[1], *samplers))  # has no tiles yet
draw.draw(3)
draw.end()

# ... and warp for the newest poses.
draw = encoder.begin_render_pass(color_attachments=[{"view": panel.create_view(), **cleared}])
draw.set_pipeline(warp)
draw.set_bind_group(0, bound(warp_bindings, uniforms, *views, tiles.create_view(), *samplers))
draw.set_vertex_buffer(0, panel_position)
draw.set_vertex_buffer(1, buffer(mesh.rays(pupil)[0], "VERTEX"))
draw.set_index_buffer(triangles, "uint32")
draw.draw_indexed(mesh.triangles.size)
draw.end()
device.queue.submit([encoder.finish()])
shown = read(panel, np.uint8)[..., :3]
write_png("panel.png", shown)
print(f"{device.adapter.info['device']}: {len(mesh.triangles)} triangles, rays within {mesh.bound_arcmin:.3f} arcmin")

# The compositor's picture of the same colour and depth.
with wlr.Compositor(eye, SIZE) as compositor:
    wanted = compositor.begin_frame(drawn_pose, pupil)["right"]
    assert wanted.size_px == camera.size_px
    compositor.submit(read(picture, np.uint8), read(depth, np.float32)[..., 0], stored=STORED)
    difference = np.abs(compositor.compose(pose=newest_pose).read().astype(int) - shown).max(axis=-1)
print(f"sRGB codes: 99 % of the pixels within {np.percentile(difference, 99):.0f},", end=" ")
print(f"{(difference > 8).mean():.2%} differ by more than 8 from the compositor's")
