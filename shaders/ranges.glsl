// Bounds of the inverse depth along a bundle of paths, from a pyramid of the image's smallest and largest values.
//
// Needs TILE and SURFACE_STEP.

const float FINEST_PX = 2.0 * float(TILE);  // side of the area that a texel of the finest level covers
uniform sampler2D ranges;  // see range_pyramid.frag

// Bounds of the four texels of a level around a corner, which is counted from the image's upper left corner.
vec2 range_at(vec2 corner, float finest_per_texel, vec2 size)
{
    float left = 2.0 * size.y * (1.0 - 1.0 / finest_per_texel);
    return sampled(ranges, (corner + vec2(left + 0.5, 0.5)) / size).xy;
}

// Bounds of the whole image.
vec2 range_of_image()
{
    vec2 size = vec2(textureSize(ranges, 0));
    return range_at(vec2(1.0), 0.5 * size.y, size);
}

// Bounds within a square of this side around a position, from 4 x 4 texels of a level, at most 2.7 times as wide.
vec2 range_around(vec2 middle, float side_px)
{
    vec2 size = vec2(textureSize(ranges, 0));
    float finest_per_texel = exp2(clamp(ceil(log2(side_px / (3.0 * FINEST_PX))), 0.0, log2(size.y) - 2.0));
    vec2 corner = round(middle / (FINEST_PX * finest_per_texel));
    corner = clamp(corner, vec2(2.0), vec2(size.y / finest_per_texel - 2.0));
    vec2 seen = range_at(corner - 1.0, finest_per_texel, size);
    for (int k = 1; k < 4; ++k) {
        vec2 one = range_at(corner + vec2(k % 2, k / 2) * 2.0 - 1.0, finest_per_texel, size);
        seen = vec2(min(seen.x, one.x), max(seen.y, one.y));
    }
    return seen;
}

// Bounds of the image's surfaces along the part `within` (near end y, far end x) of a bundle of paths of this width. A
// ray that is in front of everything at the near end, and behind everything at the far end, still is so at the new
// ends.
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

// `within`, cut to its equal parts from the first to the last in which a ray may meet something: in other parts the ray
// is in front of all the image's surfaces, or behind them. The search ends at a part in which all rays must meet one
// surface, because they are in front of it at the near end and behind it at the far end.
vec2 searched(vec2 at_infinity, vec2 shift, vec2 within, int parts, float width_px, vec2 size_px)
{
    vec2 found = within;
    bool begun = false, ended = false;
    for (int k = 0; k < parts && !ended; ++k) {
        float near_end = mix(within.y, within.x, float(k) / float(parts));
        float far_end = k + 1 == parts ? within.x : mix(within.y, within.x, float(k + 1) / float(parts));
        vec2 seen = range_along(at_infinity, shift, vec2(far_end, near_end), width_px, size_px);
        bool may_meet = seen.y >= far_end && seen.x <= near_end;
        found.y = may_meet && !begun ? min(near_end, seen.y) : found.y;
        found.x = may_meet ? max(far_end, seen.x) : found.x;
        begun = begun || may_meet;
        bool one_surface = seen.y - seen.x <= SURFACE_STEP * seen.y;
        ended = may_meet && one_surface && seen.y <= near_end && seen.x >= far_end;
    }
    return vec2(min(found.x, found.y), found.y);
}
