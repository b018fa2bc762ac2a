// Intersect a ray with the depth of the intermediate image, texel by texel; warp/warp.py states the algorithm.
//
// Needs SURFACE_STEP, TILE, and the pixel shader's `inverse_depth`, `size_px` and `per_texel`. There is one loop with
// the same reads in each iteration, because software renderers execute both sides of a branch. They may leave the loop
// for all neighbours at once, so the variables of the result (meets, met, in_front) must not change once a pixel has
// stopped.

TEXTURE(3) tiles;  // smallest and largest inverse depth of TILE x TILE texels

const float NUDGE_PX = 1e-3;  // texels that a path crosses over a shorter length are skipped
const float MARGIN_PX = float(TILE);
const float UNKNOWN = -1.0;

float inverse_depth_at(vec2 pixel)
{
    return INVERSE_DEPTHS(nearest_sampled(inverse_depth, pixel * per_texel)).x;
}

float smooth_inverse_depth(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 shared_corner = (base + 1.0) * per_texel;
    vec4 texels = INVERSE_DEPTHS(gathered(inverse_depth, shared_corner));  // lower left, lower right, upper right, upper left
    float high = max(max(texels.x, texels.y), max(texels.z, texels.w));
    float low = min(min(texels.x, texels.y), min(texels.z, texels.w));
    weight = high - low > SURFACE_STEP * high ? step(0.5, weight) : weight;
    return mix(mix(texels.w, texels.z, weight.x), mix(texels.x, texels.y, weight.x), weight.y);
}

// Whether two neighbours are of one surface: the step between them is small, or opens less than half a pixel.
bool is_one_surface(float one, float other, float half_px)
{
    return abs(one - other) <= max(SURFACE_STEP * max(one, other), half_px);
}

// Position at which to read colour near a pixel: of the four texels around it, texels of a surface other than the one
// at this inverse depth are ignored, except a texel within half a pixel of the surface.
vec2 place_on_surface(vec2 pixel, float met, float half_px)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec4 texels = INVERSE_DEPTHS(gathered(inverse_depth, (base + 1.0) * per_texel));  // in the same order
    vec4 belongs = vec4(lessThanEqual(abs(texels - met), max(SURFACE_STEP * max(texels, met), half_px)));
    vec4 share = belongs * vec4(1.0 - weight.x, weight.xx, 1.0 - weight.x) * vec4(weight.yy, 1.0 - weight.yy);
    float largest = max(max(share.x, share.y), max(share.z, share.w));
    vec2 own = vec2(max(share.y, share.z) == largest, max(share.x, share.y) == largest);
    float row = mix(belongs.z * belongs.w, belongs.x * belongs.y, own.y);
    float column = mix(belongs.x * belongs.w, belongs.y * belongs.z, own.x);
    bool all_belong = belongs.x * belongs.y * belongs.z * belongs.w == 1.0;
    vec2 moved = row == 1.0 ? vec2(weight.x, own.y) : column == 1.0 ? vec2(own.x, weight.y) : own;
    return base + 0.5 + (all_belong || largest == 0.0 ? weight : moved);
}

// Find the position that a ray shows, the inverse depth seen there, and the inverse depth equivalent to half a pixel,
// from the bounds of the inverse depth along its path.
int march(vec2 at_infinity, vec2 shift, vec2 range, out vec2 pixel, out float seen_there, out float half_px)
{
    float px_per_inverse_depth = max(length(shift), 1e-12), one_px = 1.0 / px_per_inverse_depth;
    vec2 nudge = -NUDGE_PX * one_px * shift;
    vec2 ahead = vec2(lessThan(shift, vec2(0.0)));  // 1 where coordinates grow along the path
    vec2 per_shift = (1.0 - 2.0 * ahead) / max(abs(shift), 1e-12);
    vec2 tiles_per_px = 1.0 / (float(TILE) * vec2(size_of(tiles)));

    // The path inside the image and a margin in which the border repeats: a very near texel may start it far outside.
    vec2 from_first = (-MARGIN_PX - at_infinity) * per_shift, from_last = (size_px + MARGIN_PX - at_infinity) * per_shift;
    vec2 enters = max(from_first, from_last), leaves_image = min(from_first, from_last);
    // Widened, so that rounded bounds leave out no depth between them.
    float last = range.x * (1.0 - 1e-6), far_end = max(last, max(leaves_image.x, leaves_image.y));
    float here = min(range.y * (1.0 + 1e-6), min(enters.x, enters.y));
    bool never_enters = here < far_end;
    float before = UNKNOWN, met = here;
    bool in_front = true, meets = false, searching = true;
    do {
        vec2 place = at_infinity + here * shift + nudge;
        vec2 texel = floor(place), tile = floor(place / float(TILE));
        vec2 leaves = (texel + ahead - at_infinity) * per_shift;
        vec2 leaves_tile = ((tile + ahead) * float(TILE) - at_infinity) * per_shift;
        // By rounding, a border that the path has just crossed, or hardly approaches, may lie behind it.
        leaves = mix(leaves, vec2(here - one_px), greaterThanEqual(leaves, vec2(here)));
        leaves_tile = mix(leaves_tile, vec2(here - one_px), greaterThanEqual(leaves_tile, vec2(here)));
        float end = max(max(leaves.x, leaves.y), far_end), end_of_tile = max(max(leaves_tile.x, leaves_tile.y), far_end);
        vec2 bounds = nearest_sampled(tiles, (tile + 0.5) * float(TILE) * tiles_per_px).xy;
        float seen = inverse_depth_at(texel + 0.5);

        bool is_behind = seen > here;
        bool behind_tile = !in_front && bounds.x > here && is_one_surface(bounds.x, bounds.y, 0.5 * one_px);
        bool skips = bounds.y < end_of_tile || behind_tile;
        // At its start the path is in front, or just outside the image, where it has met the border's surface.
        bool joins = before == UNKNOWN || is_one_surface(before, seen, 0.5 * one_px);
        meets = meets || searching && !skips && seen >= end && (!is_behind || in_front && joins);
        bool edge = !meets && !skips && is_behind && !joins;
        met = !searching ? met : meets ? min(seen, here) : edge ? max(seen, before) : met;
        before = skips ? bounds.y : seen;
        in_front = searching && !skips ? !is_behind : in_front;
        here = meets ? here : min(skips ? end_of_tile : end, here * (1.0 - 1e-7));
        searching = !meets && here > far_end;
    } while (searching);
    // Two steps, then the limit to which the steps converge on a plane.
    float second = smooth_inverse_depth(at_infinity + met * shift);
    float third = smooth_inverse_depth(at_infinity + second * shift);
    float first_step = second - met, second_step = third - second;
    bool converges = abs(second_step) < 0.5 * abs(first_step);
    float limit = converges ? third + second_step * second_step / (first_step - second_step) : third;
    bool stays = meets && abs(limit - met) * px_per_inverse_depth < 1.5;
    bool is_outside = never_enters || !meets && in_front && far_end > last;
    met = stays ? limit : met;
    pixel = is_outside ? vec2(-MARGIN_PX) : at_infinity + met * shift;
    seen_there = meets ? met : inverse_depth_at(pixel);
    half_px = 0.5 * one_px;
    return meets ? SEEN : DISOCCLUDED;
}
