// Where a bent ray meets what the intermediate image shows: rendering/warped_image.py has the rule.
//
// Needs STEP_PX, MAX_MARCH, MAX_STEPS, SETTLED_PX, SURFACE_STEP, TILE, and of the pixel shader `inverse_depth`, `ranges`,
// `per_texel` and `whole_range`. One loop with one texture read in each turn, tested at its head: software renderers
// run both sides of a branch, and mix the turns of neighbouring pixels in a loop that is left from within.

float nearest_inverse_depth(vec2 pixel)
{
    return texture(inverse_depth, pixel * per_texel).r;
}

float smooth_inverse_depth(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 shared_corner = (base + 1.0) * per_texel;
    vec4 taps = textureGather(inverse_depth, shared_corner);  // lower left, lower right, upper right, upper left
    float high = max(max(taps.x, taps.y), max(taps.z, taps.w));
    float low = min(min(taps.x, taps.y), min(taps.z, taps.w));
    weight = high - low > SURFACE_STEP * high ? step(0.5, weight) : weight;
    return mix(mix(taps.w, taps.z, weight.x), mix(taps.x, taps.y, weight.x), weight.y);
}

// The smallest and the largest inverse depth that the image shows along a path.
vec2 range_along(vec2 at_infinity, vec2 shift, float px_per_inverse_depth)
{
    vec2 middle = at_infinity + 0.5 * whole_range.y * shift;
    vec2 per_tile = 1.0 / (vec2(textureSize(ranges, 0)) * float(TILE));
    vec2 inside = clamp(middle, vec2(0.0), 1.0 / per_texel);
    return px_per_inverse_depth * whole_range.y <= 2.0 * float(TILE) ? texture(ranges, inside * per_tile).xy : whole_range;
}

int follow(vec2 at_infinity, vec2 shift, out vec2 pixel)
{
    float px_per_inverse_depth = length(shift);
    vec2 range = range_along(at_infinity, shift, px_per_inverse_depth);
    float turns = clamp(ceil(px_per_inverse_depth * (range.y - range.x) / STEP_PX), 1.0, float(MAX_MARCH));
    float stride = (range.y - range.x) / turns;

    float before = nearest_inverse_depth(at_infinity + range.y * shift);
    float turn = 1.0;
    float far_end = range.y - stride;
    bool refining = turns == 1.0;
    float asked = refining ? before : far_end;
    float ahead = asked;  // what is seen at the far end
    bool in_front = true;
    bool settled = false;
    float passed = range.y;
    int steps = 0;
    while (!settled && turn <= turns) {
        float seen = smooth_inverse_depth(at_infinity + asked * shift);
        // While marching:
        ahead = refining ? ahead : seen;
        bool reached = in_front && (max(before, seen) >= far_end || turn == turns);
        bool before_fits = abs(before - far_end - 0.5 * stride) <= 1.5 * stride;
        float start = before_fits ? before : seen;
        // While refining:
        settled = refining && abs(seen - asked) * px_per_inverse_depth < SETTLED_PX;
        steps = refining ? steps + 1 : 0;

        float next = refining ? seen : start;
        bool fits = abs(next - far_end - 0.5 * stride) <= 1.5 * stride || turns == 1.0;
        bool goes_on = fits && (refining ? steps < MAX_STEPS : reached);
        bool failed = !goes_on && (refining || reached);
        passed = failed ? max(next, refining ? asked : before) : passed;
        bool next_turn = !settled && !goes_on;
        in_front = next_turn ? ahead < far_end : in_front;
        before = next_turn ? ahead : before;
        turn += next_turn ? 1.0 : 0.0;
        far_end = next_turn ? range.y - turn * stride : far_end;
        refining = !next_turn;
        asked = next_turn ? far_end : next;
    }
    pixel = at_infinity + (settled ? asked : passed) * shift;
    return settled ? SEEN : DISOCCLUDED;
}
