#version 410
// The pyramid of smallest and largest values that ranges.glsl reads, from those of the tiles.
//
// Levels lie side by side, with n, n / 2, ... 2 texels along each axis; n is the target's height. A place holds the bounds
// of the four texels around its upper left corner, so that one read gets them. Tiles beyond the image repeat its last
// ones.

uniform sampler2D tiles;
uniform int target_height;

layout(location = 0) out vec2 range;

void main()
{
    ivec2 place = ivec2(gl_FragCoord.xy), size = textureSize(tiles, 0);
    int side = target_height, tiles_per_texel = 1;
    while (place.x >= side && side > 2) {
        place.x -= side;
        side /= 2;
        tiles_per_texel *= 2;
    }
    range = vec2(0.0);
    if (place.x >= side || place.y >= side)
        return;
    ivec2 first = clamp((place - 1) * tiles_per_texel, ivec2(0), size - 1);
    ivec2 end = clamp((place + 1) * tiles_per_texel, first + 1, size);
    vec4 low = vec4(uintBitsToFloat(0x7f800000u)), high = vec4(0.0);
    for (int y = first.y; y < end.y; y += 2) {
        for (int x = first.x; x < end.x; x += 2) {
            ivec2 last = min(ivec2(x, y) + 1, end - 1);
            vec4 columns = vec4(texelFetch(tiles, ivec2(x, y), 0).xy, texelFetch(tiles, ivec2(last.x, y), 0).xy);
            vec4 below = vec4(texelFetch(tiles, ivec2(x, last.y), 0).xy, texelFetch(tiles, last, 0).xy);
            low = min(low, vec4(columns.xz, below.xz));
            high = max(high, vec4(columns.yw, below.yw));
        }
    }
    range = vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}
