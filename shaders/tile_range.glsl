// Smallest and largest value of an image in the tile at a pixel of the tiles; beyond the border the image repeats.
vec2 range_of_tile(IMAGE values, vec2 tile)
{
    vec2 per_texel = 1.0 / vec2(size_of(values)), first = floor(tile) * float(TILE) + 1.0;
    vec4 low = INVERSE_DEPTHS(gathered(values, first * per_texel)), high = low;
    // Unrolled, because a loop whose bounds depend on the image takes twice as long in software renderers.
    for (int k = 1; k < TILE * TILE / 4; ++k) {
        vec2 shared_corner = first + 2.0 * vec2(k % (TILE / 2), k / (TILE / 2));
        vec4 four = INVERSE_DEPTHS(gathered(values, shared_corner * per_texel));
        low = min(low, four);
        high = max(high, four);
    }
    return vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}
