#version 410
#include "texels.glsl"
#define INVERSE_DEPTHS(texels) texels
#include "tile_range.glsl"

uniform sampler2D inverse_depths;

layout(location = 0) out vec2 range;

void main()
{
    range = range_of_tile(inverse_depths, gl_FragCoord.xy);
}
