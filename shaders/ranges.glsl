// Bounds of the inverse depth along a path, from a pyramid of the image's smallest and largest ones.
//
// Needs TILE, the side in pixels of what a texel of the finest level covers.

uniform sampler2D ranges;  // see range_pyramid.frag

// Bounds within a square of this side around a position. The four texels around a corner of a level whose texels are no
// smaller than the square cover it.
vec2 range_around(vec2 middle, float side_px)
{
    vec2 size = vec2(textureSize(ranges, 0));
    float tiles_per_texel = exp2(clamp(ceil(log2(side_px / float(TILE))), 0.0, log2(size.y) - 1.0));
    vec2 corner = round(middle / (float(TILE) * tiles_per_texel));
    corner = clamp(corner, vec2(1.0), vec2(size.y / tiles_per_texel - 1.0));
    vec2 place = (corner + vec2(2.0 * size.y * (1.0 - 1.0 / tiles_per_texel), 0.0)) / size;
    vec4 low = textureGather(ranges, place, 0), high = textureGather(ranges, place, 1);
    return vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}

// Bounds of what the image shows along the part `within` (near end y, far end x) of a path, or of a bundle of paths of
// this width. A ray in front of everything at the near end, and behind it at the far end, still is at the new ends.
vec2 range_along(vec2 at_infinity, vec2 shift, vec2 within, float width_px, vec2 size_px)
{
    vec2 middle = clamp(at_infinity + 0.5 * (within.x + within.y) * shift, vec2(0.0), size_px);
    float length_px = max(abs(shift.x), abs(shift.y)) * (within.y - within.x);
    return range_around(middle, length_px + width_px);
}

vec2 narrowed(vec2 at_infinity, vec2 shift, vec2 within, float width_px, vec2 size_px)
{
    vec2 seen = range_along(at_infinity, shift, within, width_px, size_px);
    return vec2(max(within.x, seen.x), max(max(within.x, seen.x), min(within.y, seen.y)));
}
