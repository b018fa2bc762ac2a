#version 410
#include "texels.glsl"
// The smallest and the largest value in each tile of an image; beyond its border the image repeats.

uniform sampler2D values;

layout(location = 0) out vec2 range;

void main()
{
    vec2 per_texel = 1.0 / vec2(textureSize(values, 0)), first = floor(gl_FragCoord.xy) * float(TILE) + 1.0;
    vec4 low = gathered(values, first * per_texel), high = low;
    // Unrolled: a loop whose ends depend on the image takes software renderers twice as long.
    for (int k = 1; k < TILE * TILE / 4; ++k) {
        vec2 shared_corner = first + 2.0 * vec2(k % (TILE / 2), k / (TILE / 2));
        vec4 four = gathered(values, shared_corner * per_texel);
        low = min(low, four);
        high = max(high, four);
    }
    range = vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}
