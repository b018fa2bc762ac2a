// Intersect a ray with the depth of the intermediate image; warp/warp.py states the algorithm.
//
// Needs STEP_PX, MAX_STEPS, MAX_REFINEMENTS, CONVERGED_PX, SURFACE_STEP, and of the pixel shader `inverse_depth`,
// `range`, `size_px` and `per_texel`. One loop with one texture read in each round, whether it marches or refines:
// software renderers execute both sides of a branch, and one round too many of a loop tested at its head. They leave a
// loop tested at its end for all neighbours at once, and may mix the last rounds: so the variables of the result (query,
// last_crossing, converged) no longer change once a pixel has stopped searching.

const float PART_PX = float(TILE) - 3.0;  // with its margin as long as the pyramid's finest texels
const int MAX_PARTS = 24;

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

int march(vec2 at_infinity, vec2 shift, out vec2 pixel)
{
    float px_per_inverse_depth = length(shift);
    float path_px = px_per_inverse_depth * (range.y - range.x);
    int parts = path_px > PART_PX ? min(int(path_px / PART_PX) + 1, MAX_PARTS) : 0;
    vec2 within = searched(at_infinity, shift, range, parts, 3.0, size_px, false);
    // Twice, because bounds near a depth edge come from a longer path than is left.
    within = narrowed(at_infinity, shift, within, 3.0, size_px, false);
    within = narrowed(at_infinity, shift, within, 3.0, size_px, false);
    float step_count = clamp(ceil(px_per_inverse_depth * (within.y - within.x) / STEP_PX), 1.0, float(MAX_STEPS));
    float stride = (within.y - within.x) / step_count;

    float step_index = 1.0;
    float far_end = within.y - stride;
    float seen_near = nearest_inverse_depth(at_infinity + within.y * shift);  // at the step's two ends
    float seen_far = seen_near;
    bool in_front = true;  // at its near end
    bool refining = step_count == 1.0;
    float query = refining ? seen_near : far_end;
    float last_crossing = within.y;
    int refinements = 0;
    bool converged = false;
    bool searching;
    do {
        searching = !converged && step_index <= step_count;
        float seen = smooth_inverse_depth(at_infinity + query * shift);
        bool closes = abs(seen - query) * px_per_inverse_depth < CONVERGED_PX;
        converged = converged || searching && refining && closes;

        seen_far = refining ? seen_far : seen;
        float nearer = max(seen_near, seen_far), farther = min(seen_near, seen_far);
        float middle = far_end + 0.5 * stride;
        bool crosses = in_front ? nearer >= far_end || step_index == step_count : abs(seen_far - middle) <= 0.51 * stride;
        float start = abs(nearer - middle) <= 1.5 * stride ? nearer : farther;
        float next = refining ? seen : start;
        refinements = refining ? refinements + 1 : 0;
        bool is_near_step = step_count == 1.0 || abs(next - middle) <= 1.5 * stride;
        bool continues = is_near_step && (refining ? refinements < MAX_REFINEMENTS : crosses);
        bool misses = !continues && (refining || crosses);
        last_crossing = searching && misses ? (refining ? max(seen, query) : nearer) : last_crossing;

        bool advances = !converged && !continues;
        in_front = advances ? seen_far < far_end : in_front;
        seen_near = advances ? seen_far : seen_near;
        step_index += advances ? 1.0 : 0.0;
        far_end = advances ? within.y - step_index * stride : far_end;
        refining = !advances;
        query = !searching ? query : advances ? far_end : next;
    } while (!converged && step_index <= step_count);
    pixel = at_infinity + (converged ? query : last_crossing) * shift;
    return converged ? SEEN : DISOCCLUDED;
}
