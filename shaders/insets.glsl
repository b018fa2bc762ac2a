// What cells.frag writes of a cell beside its paths, and whether an inset fills it.

const float INSET_SLACK_PX = 6.0;  // how far paths bulge within a cell
const float COVERED = 2.0 * MISSING;  // the range of a cell that the next sharper picture fills

// Bounds of a cell together with the samples of its display pixels along each axis, from 1 to MOST_SAMPLES, as two numbers:
// negative from 2 samples on, and for each further one 2^20 times larger, more than any inverse depth.
vec2 with_samples(vec2 range, float samples)
{
    int further = int(clamp(samples, 1.0, MOST_SAMPLES)) - 2;
    return further < 0 ? range : -ldexp(1.0 + range, ivec2(20 * further));
}

vec2 without_samples(vec2 range, out float samples)
{
    int further = range.x < 0.0 ? int((log2(-range.x) + 0.01) / 20.0) : -1;
    samples = float(further + 2);
    return further < 0 ? range : -1.0 - ldexp(range, ivec2(-20 * further));
}

// Whether all that a cell may show lies inside a picture, for all channels.
bool is_filled(sampler2D paths, sampler2D ranges, ivec2 upper_left, vec2 picture_size_px)
{
    int rows = textureSize(paths, 0).y / CHANNELS;
    bool filled = true;
    for (int k = 0; k < 4 * CHANNELS; ++k) {
        ivec2 cell = upper_left + ivec2(0, k / 4 * rows);
        vec4 path = fetched(paths, cell + ivec2(k % 2, k % 4 / 2));
        float samples;
        vec2 range = without_samples(fetched(ranges, cell).zw, samples);
        vec2 one = path.xy + range.x * path.zw, other = path.xy + range.y * path.zw;
        bool inside = all(greaterThan(min(one, other), vec2(INSET_SLACK_PX))) &&
                      all(lessThan(max(one, other), picture_size_px - INSET_SLACK_PX));
        filled = filled && (inside || range.x == COVERED);
    }
    return filled;
}
