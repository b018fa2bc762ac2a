#version 430
#include "conventions.glsl"
// Takes over a picture that other software drew upwards: its colour, and 1 / depth from its depth buffer.

uniform sampler2D upward_colour;
uniform sampler2D upward_depth;
uniform float near;

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;

void main()
{
    ivec2 texel = turned_upside_down(ivec2(gl_FragCoord.xy), textureSize(upward_depth, 0).y);
    colour = vec4(texelFetch(upward_colour, texel, 0).rgb, 1.0);
    inverse_depth = inverse_depth_of_depth_buffer(texelFetch(upward_depth, texel, 0).r, near);
}
