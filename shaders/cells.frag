#version 410
#include "conventions.glsl"
#include "texels.glsl"
#include "ranges.glsl"
#include "cell_notes.glsl"
// For each point of a warp grid: the path of its ray in the image, second differences of the paths, and bounds of the
// inverse depth for the cell to the lower right. Channels are stacked vertically.

uniform sampler2D slope_offset[CHANNELS];
uniform bool has_row_matrices;
uniform sampler2D row_matrices;  // image from ray, for each row of the grid; three texels per row
// The inputs of a picture in one array, which one OpenGL call writes: the pictures of several eyes share the program.
uniform vec4 inputs_of_picture[4];
vec4 camera_matrix[3] = vec4[](inputs_of_picture[0], inputs_of_picture[1], inputs_of_picture[2]);  // image from ray, for all rows
vec2 size_px = inputs_of_picture[3].xy;  // size of the image
vec2 display_px_per_cell = inputs_of_picture[3].zw;
uniform bool is_inset;
uniform bool has_inset;
uniform sampler2D inset_ranges;  // ranges of the next sharper picture

layout(location = 0) out vec4 path;  // position at infinity, shift; x = MISSING without a ray
layout(location = 1) out vec4 bend;  // second differences along the rows and along the columns
layout(location = 2) out vec4 mixed_bend_and_range;  // for the range see range_of_cell, with_notes

const int SEARCHES = 3, PARTS = 8;
const float SHORT_PX = 4.0;  // length of paths that are not worth splitting
const float SLACK_PX = 6.0;  // reach of the depth filter, plus the bulge of paths within a cell

vec4 path_at(int channel, ivec2 point)
{
    if (any(lessThan(point, ivec2(0))) || any(greaterThanEqual(point, textureSize(slope_offset[0], 0))))
        return vec4(MISSING, 0.0, 0.0, 0.0);
    vec4 ray = vec4(0.0);
    for (int k = 0; k < CHANNELS; ++k)
        ray = k == channel ? fetched(slope_offset[k], point) : ray;
    vec4 matrix[3] = camera_matrix;
    if (has_row_matrices)
        for (int k = 0; k < 3; ++k)
            matrix[k] = fetched(row_matrices, ivec2(k, point.y));
    vec4 found;
    bool forwards = project_ray(ray, matrix[0], matrix[1], matrix[2], found.xy, found.zw);
    // Tested by its bits, because compilers may assume that isnan is false.
    bool known = forwards && all(notEqual(floatBitsToUint(found) & 0x7f800000u, uvec4(0x7f800000u)));
    return known ? found : vec4(MISSING, 0.0, 0.0, 0.0);
}

bool is_known(vec4 one)
{
    return one.x < 0.5 * MISSING;
}

// Second difference along a step at the point; if a neighbour is missing, the mean at the adjacent points.
vec2 second_difference(int channel, ivec2 point, ivec2 along)
{
    vec4 line[5];
    for (int k = 0; k < 5; ++k)
        line[k] = path_at(channel, point + (k - 2) * along);
    vec3 sum[3];
    for (int k = 0; k < 3; ++k) {
        bool known = is_known(line[k]) && is_known(line[k + 1]) && is_known(line[k + 2]);
        sum[k] = known ? vec3(line[k].xy - 2.0 * line[k + 1].xy + line[k + 2].xy, 1.0) : vec3(0.0);
    }
    vec3 beside = sum[0] + sum[2];
    return sum[1].z > 0.0 ? sum[1].xy : beside.xy / max(beside.z, 1.0);
}

// Mean of the mixed differences of the complete cells around the point.
vec2 mixed_difference(int channel, ivec2 point)
{
    vec4 around[9];
    for (int k = 0; k < 9; ++k)
        around[k] = path_at(channel, point + ivec2(k % 3 - 1, k / 3 - 1));
    vec3 sum = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        int first = k % 2 + 3 * (k / 2);
        bool known = is_known(around[first]) && is_known(around[first + 1]) && is_known(around[first + 3]) && is_known(around[first + 4]);
        vec2 difference = around[first].xy - around[first + 1].xy - around[first + 3].xy + around[first + 4].xy;
        sum += known ? vec3(difference, 1.0) : vec3(0.0);
    }
    return sum.xy / max(sum.z, 1.0);
}

// Bilinear samples of a display pixel along each axis that are needed to miss nothing of the image.
float samples_per_axis(vec4 corner[4])
{
    vec2 upper = corner[1].xy - corner[0].xy, lower = corner[3].xy - corner[2].xy;
    vec2 left = corner[2].xy - corner[0].xy, right = corner[3].xy - corner[1].xy;
    mat2 first = mat2(upper / display_px_per_cell.x, left / display_px_per_cell.y);
    mat2 last = mat2(lower / display_px_per_cell.x, right / display_px_per_cell.y);
    return ceil(max(largest_stretch(first), largest_stretch(last)) / SPACING_PX);
}

// Far and near bound; the near bound first if they are so close that the cell is sampled directly.
vec2 range_of_cell(int channel, ivec2 point)
{
    vec4 corner[4];
    vec4 low = vec4(MISSING), high = vec4(-MISSING);
    for (int k = 0; k < 4; ++k) {
        corner[k] = path_at(channel, point + ivec2(k % 2, k / 2));
        if (is_known(corner[k])) {
            low = min(low, corner[k]);
            high = max(high, corner[k]);
        }
    }
    if (low.x > high.x)
        return vec2(0.0);
    vec4 middle = 0.5 * (low + high), size = high - low;
    float px_per_inverse_depth = length(max(abs(low.zw), abs(high.zw)));
    vec2 within = range_of_image();
    // The cell shows nothing of the inset.
    vec2 reach = within.y * max(abs(low.zw), abs(high.zw)) + SLACK_PX;
    if (is_inset && (any(lessThan(high.xy + reach, vec2(0.0))) || any(greaterThan(low.xy - reach, size_px))))
        return vec2(MISSING);
    for (int k = 0; k < 2; ++k) {
        float width_px = max(size.x, size.y) + within.y * max(size.z, size.w) + SLACK_PX;
        within = narrowed(middle.xy, middle.zw, within, width_px, size_px);
    }
    for (int k = 0; k < SEARCHES && px_per_inverse_depth * (within.y - within.x) > SHORT_PX; ++k) {
        float width_px = max(size.x, size.y) + within.y * max(size.z, size.w) + SLACK_PX;
        within = searched(middle.xy, middle.zw, within, PARTS, width_px, size_px);
    }
    bool direct = px_per_inverse_depth * (within.y - within.x) <= DIRECT_PX;
    bool is_filled = is_inset;
    for (int k = 0; k < 4; ++k) {
        vec2 one = corner[k].xy + within.x * corner[k].zw, other = corner[k].xy + within.y * corner[k].zw;
        is_filled = is_filled && all(greaterThan(min(one, other), vec2(SLACK_PX))) &&
                    all(lessThan(max(one, other), size_px - SLACK_PX));
    }
    return with_notes(direct ? within.yx : within, samples_per_axis(corner), is_filled);
}

// Whether the cell can only show points inside the next sharper picture, which is drawn over this one.
bool is_covered(ivec2 point)
{
    bool covered = has_inset;
    for (int k = 0; k < CHANNELS; ++k) {
        float samples;
        bool is_filled;
        vec2 range = fetched(inset_ranges, point + ivec2(0, k * textureSize(slope_offset[0], 0).y)).zw;
        bool is_filled_there = without_notes(range, samples, is_filled).x == COVERED || is_filled;
        covered = covered && is_filled_there;
    }
    return covered;
}

void main()
{
    int rows = textureSize(slope_offset[0], 0).y, channel = int(gl_FragCoord.y) / rows;
    ivec2 point = ivec2(gl_FragCoord.x, int(gl_FragCoord.y) - channel * rows);
    ivec2 last = textureSize(slope_offset[0], 0) - 1;
    path = path_at(channel, point);
    bend = vec4(second_difference(channel, point, ivec2(1, 0)), second_difference(channel, point, ivec2(0, 1)));
    vec2 mixed = mixed_difference(channel, point);
    bool has_cell = all(lessThan(point, last));
    mixed_bend_and_range = vec4(mixed, has_cell ? range_of_cell(channel, point) : vec2(0.0));
    if (is_covered(point))
        mixed_bend_and_range.zw = vec2(COVERED);
}
