#version 430
#include "conventions.glsl"
// Takes over a picture that other software drew: its colour, and 1 / depth from the depth that it stored.

uniform sampler2D stored_colour;
uniform sampler2D stored_depth;
uniform bool bottom_first;
uniform bool in_metres;
uniform vec2 inverse_depth_of_0_and_1;  // where not in metres

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;

void main()
{
    ivec2 size = textureSize(stored_depth, 0), texel = ivec2(gl_FragCoord.xy);
    if (bottom_first)
        texel = turned_upside_down(texel, size.y);
    // Not texelFetch: it would decode a texture of sRGB.
    vec2 position = (vec2(texel) + 0.5) / vec2(size);
    colour = vec4(texture(stored_colour, position).rgb, 1.0);
    float stored = texture(stored_depth, position).r;
    inverse_depth =
        in_metres ? inverse_depth_of_metres(stored) : inverse_depth_of_depth_buffer(stored, inverse_depth_of_0_and_1);
}
