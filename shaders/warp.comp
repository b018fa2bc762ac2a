#version 430
#include "conventions.glsl"
#include "srgb.glsl"
#include "texels.glsl"
#include "cell_notes.glsl"
#include "warp_cell.glsl"
// The warp as a compute shader, for all cells. Some GPUs run compute shaders on more processors than fragment shaders.

layout(local_size_x = GROUP, local_size_y = GROUP) in;
layout(binding = 0) uniform writeonly image2D colour_image;
layout(binding = 1) uniform writeonly uimage2D status_image;
layout(binding = 2) uniform writeonly image2D source_image;
uniform bool with_source;
uniform usampler2D front_status;

// Values of the display pixel that warp.frag gets from the vertices of its triangle.
vec2 grid_place, panel_place, cell, range;
vec4 path[CHANNELS], bend[CHANNELS], across_and_down[CHANNELS];
vec2 mixed_bend[CHANNELS];
float known[CHANNELS], samples_per_axis, filled, nearest_shown;
bool is_direct, is_needed;

void sides_of_pixel(const int channel, out vec2 across, out vec2 down)
{
    across = across_and_down[channel].xy;
    down = across_and_down[channel].zw;
}

#include "warp.glsl"

// A triangle of a cell: its right-angled corner, the steps to the other corners, and the pixel's distances along them.
struct Triangle {
    ivec2 corner, beside, below;
    vec2 place;
};

vec4 interpolated(sampler2D values, Triangle triangle)
{
    vec4 at_corner = fetched(values, triangle.corner);
    vec4 along_row = fetched(values, triangle.corner + triangle.beside) - at_corner;
    vec4 along_column = fetched(values, triangle.corner + triangle.below) - at_corner;
    return at_corner + triangle.place.x * along_row + triangle.place.y * along_column;
}

void find_channel(const int channel, ivec2 upper_left, vec2 cells_per_pixel)
{
    vec2 within = grid_place - cell;
    bool is_first = within.x + within.y < 1.0;
    int forwards = is_first ? 1 : -1, lower = is_first ? 0 : 1;
    ivec2 corner = upper_left + ivec2(lower, lower + channel * grid_points().y);
    Triangle triangle = Triangle(corner, ivec2(forwards, 0), ivec2(0, forwards), is_first ? within : 1.0 - within);
    known[channel] = is_triangle_known(channel, upper_left, lower);
    path[channel] = interpolated(paths, triangle);
    bend[channel] = interpolated(bends, triangle);
    mixed_bend[channel] = interpolated(mixed_bends_and_ranges, triangle).xy;
    vec2 at_corner = fetched(paths, corner).xy;
    vec2 across = fetched(paths, corner + triangle.beside).xy - at_corner;
    vec2 down = fetched(paths, corner + triangle.below).xy - at_corner;
    across_and_down[channel] = float(forwards) * vec4(across * cells_per_pixel.x, down * cells_per_pixel.y);
}

void main()
{
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(colour_image);
    if (any(greaterThanEqual(texel, size)))
        return;
    ivec2 points = grid_points();
    vec2 cells_per_pixel = vec2(points - 1) / vec2(size);
    grid_place = (vec2(texel) + 0.5) * cells_per_pixel;
    panel_place = (vec2(texel) + 0.5) / vec2(size);
    ivec2 upper_left = min(ivec2(grid_place), points - 2);
    Cell of_cell = cell_at(mixed_bends_and_ranges, upper_left), front = cell_at(front_ranges, upper_left);
    if (is_backdrop ? front.is_covered || front.is_direct : of_cell.is_covered)
        return;
    cell = vec2(upper_left);
    range = of_cell.range;
    samples_per_axis = of_cell.samples_per_axis;
    is_direct = of_cell.is_direct && !is_backdrop;
    filled = of_cell.is_filled ? 1.0 : 0.0;
    nearest_shown = nearest_shown_in(front);
    find_channel(0, upper_left, cells_per_pixel);
#if CHANNELS == 3
    find_channel(1, upper_left, cells_per_pixel);
    find_channel(2, upper_left, cells_per_pixel);
#endif
    is_needed = !is_backdrop || int(texelFetch(front_status, texel, 0).r) == DISOCCLUDED;
    if (!is_needed || !shade())
        return;
    imageStore(colour_image, texel, vec4(light, alpha));
    if (is_backdrop)
        return;
    imageStore(status_image, texel, uvec4(worst));
    if (with_source)
        imageStore(source_image, texel, vec4(seen_at, 0.0, 0.0));
}
