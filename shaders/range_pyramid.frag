#version 410
#include "texels.glsl"
// The pyramid of smallest and largest values that ranges.glsl reads, from the tiles.
//
// Levels lie side by side, with n, n / 2, ... 2 texels along each axis; n is the smallest of 4, 8, 16, ... for which 2
// n covers the tiles. A texel holds the bounds of the four texels around its upper left corner, so that one read gets
// all four. Tiles beyond the image repeat the last tiles. The finest level's texels cover two tiles along each axis;
// texels of coarse levels cover whole large tiles.

uniform sampler2D tiles;
uniform sampler2D large_tiles;  // ranges of TILE x TILE tiles; the image itself while these are drawn

layout(location = 0) out vec2 range;

// Bounds of `count` tiles along each axis on either side of a corner, which is counted in tiles.
vec2 range_of(sampler2D finer, ivec2 corner, int count)
{
    ivec2 size = textureSize(finer, 0), first = clamp((corner - 1) * count, ivec2(0), size - 1);
    ivec2 end = clamp((corner + 1) * count, first + 1, size);
    vec4 low = vec4(uintBitsToFloat(0x7f800000u)), high = vec4(0.0);
    for (int y = first.y; y < end.y; y += 2) {
        for (int x = first.x; x < end.x; x += 2) {
            ivec2 last = min(ivec2(x, y) + 1, end - 1);
            vec4 columns = vec4(fetched(finer, ivec2(x, y)).xy, fetched(finer, ivec2(last.x, y)).xy);
            vec4 below = vec4(fetched(finer, ivec2(x, last.y)).xy, fetched(finer, last).xy);
            low = min(low, vec4(columns.xz, below.xz));
            high = max(high, vec4(columns.yw, below.yw));
        }
    }
    return vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}

void main()
{
    ivec2 place = ivec2(gl_FragCoord.xy);
    // A uniform in place of the sizes would cost two OpenGL calls per pass.
    ivec2 size = textureSize(tiles, 0);
    if (any(greaterThan(textureSize(large_tiles, 0), size))) {
        range = range_of(tiles, 2 * place + 1, TILE / 2);
        return;
    }
    int side = 4, tiles_per_texel = 2;
    while (2 * side < max(size.x, size.y))
        side *= 2;
    while (place.x >= side && side > 2) {
        place.x -= side;
        side /= 2;
        tiles_per_texel *= 2;
    }
    range = vec2(0.0);
    if (place.x >= side || place.y >= side)
        return;
    if (tiles_per_texel < TILE)
        range = range_of(tiles, place, tiles_per_texel);
    else
        range = range_of(large_tiles, place, tiles_per_texel / TILE);
}
