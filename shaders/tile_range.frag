#version 410
#include "texels.glsl"
#define INVERSE_DEPTHS(texels) texels
#include "tile_range.glsl"

uniform sampler2D values;

layout(location = 0) out vec2 range;

void main()
{
    range = range_of_tile(values, gl_FragCoord.xy);
}
