#version 410
#include "conventions.glsl"

uniform mat4 camera_from_mesh;
uniform mat3 camera_from_mesh_normal;
uniform vec4 lens;
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
    gl_Position = clip_of_point(point_in_camera, lens, size_px, near);
}
