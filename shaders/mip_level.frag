#version 410
#include "srgb.glsl"
// A picture shrunk along one axis: each texel is the mean of the finer texels that it covers, in linear light, those at
// its two ends by the share that it covers. Drivers' own mip levels leave out the last row or column of odd sides.

uniform sampler2D finer;
uniform int level;   // of the finer texture
uniform ivec2 size;  // of what is shrunk, from the finer level's first texel
uniform int count;   // texels of the result along the axis
uniform bool along_x;
uniform bool decodes;  // the finer texture holds sRGB codes that OpenGL does not decode
uniform bool encodes;  // the result is written as sRGB codes

layout(location = 0) out vec4 colour;

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    // In parts of a finer texel, which has `count` of them: whole numbers, so that no weight is rounded.
    int parts = along_x ? size.x : size.y;
    int first = (along_x ? at.x : at.y) * parts, end = first + parts;
    colour = vec4(0.0);
    for (int k = first / count; k * count < end; ++k) {
        int covered = min((k + 1) * count, end) - max(k * count, first);
        vec4 texel = texelFetch(finer, along_x ? ivec2(k, at.y) : ivec2(at.x, k), level);
        texel.rgb = decodes ? linear_of_srgb(texel.rgb) : texel.rgb;
        colour += float(covered) * texel;
    }
    colour /= float(parts);
    colour.rgb = encodes ? srgb_of_linear(colour.rgb) : colour.rgb;
}
