// Where a bent ray meets what the intermediate image shows: rendering/warp.py has the rule.
//
// Needs STEP_PX, MAX_MARCH, MAX_STEPS, SETTLED_PX, SURFACE_STEP, TILE, and of the pixel shader `inverse_depth`,
// `ranges` and what warp.vert gives. One loop with one texture read in each round, whether it marches or refines:
// software renderers run both sides of a branch, and one round too many of a loop tested at its head. A loop tested at
// its end they leave for all neighbours at once, and may mix their last rounds: so what the result is made of (asked,
// passed, settled) stays as it is once a pixel has stopped searching.

float nearest_inverse_depth(vec2 pixel)
{
    return texture(inverse_depth, pixel * per_texel).r;
}

float smooth_inverse_depth(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 shared_corner = (base + 1.0) * per_texel;
    vec4 texels = textureGather(inverse_depth, shared_corner);  // lower left, lower right, upper right, upper left
    float high = max(max(texels.x, texels.y), max(texels.z, texels.w));
    float low = min(min(texels.x, texels.y), min(texels.z, texels.w));
    weight = high - low > SURFACE_STEP * high ? step(0.5, weight) : weight;
    return mix(mix(texels.w, texels.z, weight.x), mix(texels.x, texels.y, weight.x), weight.y);
}

// The smallest and the largest inverse depth that the image shows along a path.
vec2 range_along(vec2 at_infinity, vec2 shift, float px_per_inverse_depth)
{
    vec2 middle = at_infinity + 0.5 * whole_range.y * shift;
    vec2 around_middle = texture(ranges, clamp(middle, vec2(0.0), size_px) * per_px_of_tiles).xy;
    return px_per_inverse_depth * whole_range.y <= 2.0 * float(TILE) ? around_middle : whole_range;
}

int follow(vec2 at_infinity, vec2 shift, out vec2 pixel)
{
    float px_per_inverse_depth = length(shift);
    vec2 range = range_along(at_infinity, shift, px_per_inverse_depth);
    float turns = clamp(ceil(px_per_inverse_depth * (range.y - range.x) / STEP_PX), 1.0, float(MAX_MARCH));
    float stride = (range.y - range.x) / turns;

    float turn = 1.0;
    float far_end = range.y - stride;
    float seen_near = nearest_inverse_depth(at_infinity + range.y * shift);  // from the turn's two ends
    float seen_far = seen_near;
    bool in_front = true;  // at its near end
    bool refining = turns == 1.0;
    float asked = refining ? seen_near : far_end;
    float passed = range.y;
    int steps = 0;
    bool settled = false;
    bool searching;
    do {
        searching = !settled && turn <= turns;
        float seen = smooth_inverse_depth(at_infinity + asked * shift);
        bool closes = abs(seen - asked) * px_per_inverse_depth < SETTLED_PX;
        settled = settled || searching && refining && closes;

        seen_far = refining ? seen_far : seen;
        float nearer = max(seen_near, seen_far), farther = min(seen_near, seen_far);
        float middle = far_end + 0.5 * stride;
        bool comes_past = in_front ? nearer >= far_end || turn == turns : abs(seen_far - middle) <= 0.51 * stride;
        float start = abs(nearer - middle) <= 1.5 * stride ? nearer : farther;
        float next = refining ? seen : start;
        steps = refining ? steps + 1 : 0;
        bool within = turns == 1.0 || abs(next - middle) <= 1.5 * stride;
        bool goes_on = within && (refining ? steps < MAX_STEPS : comes_past);
        bool fails = !goes_on && (refining || comes_past);
        passed = searching && fails ? (refining ? max(seen, asked) : nearer) : passed;

        bool turns_over = !settled && !goes_on;
        in_front = turns_over ? seen_far < far_end : in_front;
        seen_near = turns_over ? seen_far : seen_near;
        turn += turns_over ? 1.0 : 0.0;
        far_end = turns_over ? range.y - turn * stride : far_end;
        refining = !turns_over;
        asked = !searching ? asked : turns_over ? far_end : next;
    } while (!settled && turn <= turns);
    pixel = at_infinity + (settled ? asked : passed) * shift;
    return settled ? SEEN : DISOCCLUDED;
}
