#version 410
#include "srgb.glsl"
// Shrink a picture along one axis: each texel is the mean, in linear light, of the finer texels that it covers,
// weighted by the covered share. Drivers' mip levels leave out the last row or column of odd sides.

uniform sampler2D finer;
uniform int level;   // level of the finer texture
uniform ivec2 size;  // size of the shrunk area, from the finer level's first texel
uniform int count;   // number of texels of the result along the axis
uniform bool along_x;
uniform bool decodes;  // whether the finer texture holds sRGB codes that OpenGL does not decode
uniform bool encodes;  // whether the result is written as sRGB codes

layout(location = 0) out vec4 colour;

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    // In units of 1 / `count` of a finer texel: whole numbers, so that no weight is rounded.
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
