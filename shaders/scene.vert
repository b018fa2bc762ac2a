#version 410

uniform mat4 camera_from_mesh;
uniform mat3 camera_from_mesh_normal;
uniform vec4 lens;  // focal_u, focal_v, centre_u, centre_v in pixels
uniform vec2 size_px;
uniform float near;

layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec3 vertex_colour;

out vec3 point_in_camera;
out vec3 normal_in_camera;
out vec2 texture_uv;
out vec3 interpolated_colour;

void main()
{
    point_in_camera = (camera_from_mesh * vec4(position, 1.0)).xyz;
    normal_in_camera = normalize(camera_from_mesh_normal * normal);
    texture_uv = uv;
    interpolated_colour = vertex_colour;
    // The camera looks along -z; its far plane is at infinity. The sign of y makes the top row first in memory.
    float depth = -point_in_camera.z;
    vec2 pixel_times_depth = lens.xy * vec2(point_in_camera.x, -point_in_camera.y) + lens.zw * depth;
    gl_Position = vec4(2.0 * pixel_times_depth / size_px - depth, depth - 2.0 * near, depth);
}
