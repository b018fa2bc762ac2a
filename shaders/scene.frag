#version 410
#include "shading.glsl"
#include "srgb.glsl"

uniform vec3 base_colour;
uniform bool has_texture;
uniform sampler2D base_texture;

in vec3 point_in_camera;
in vec3 normal_in_camera;
in vec2 texture_uv;
in vec3 interpolated_colour;

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;

void main()
{
    vec3 normal = normalize(normal_in_camera);
    normal = dot(normal, point_in_camera) > 0.0 ? -normal : normal;
    vec3 albedo = base_colour * interpolated_colour;
    if (has_texture) {
        albedo *= texture(base_texture, texture_uv).rgb;
    }
    colour = vec4(srgb_of_linear(albedo * irradiance(point_in_camera, normal)), 1.0);
    inverse_depth = gl_FragCoord.w;
}
