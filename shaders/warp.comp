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

// Of the display pixel: what warp.frag gets from the vertices of its triangle.
vec2 grid_place, panel_place, cell, range;
vec4 path[CHANNELS], bend[CHANNELS], across_and_down[CHANNELS];
vec2 mixed_bend[CHANNELS];
float known[CHANNELS], samples_per_axis, filled;
bool is_direct;

void sides_of_pixel(const int channel, out vec2 across, out vec2 down)
{
    across = across_and_down[channel].xy;
    down = across_and_down[channel].zw;
}

#include "warp.glsl"

// Along the sides of a cell's triangle, per cell.
vec4 interpolated(vec4 corner, vec4 along_row, vec4 along_column, vec2 from_corner)
{
    return corner + from_corner.x * along_row + from_corner.y * along_column;
}

void find_channel(const int channel, ivec2 upper_left, vec2 cells_per_pixel)
{
    vec2 within = grid_place - cell;
    int triangle = within.x + within.y < 1.0 ? 0 : 1;
    known[channel] = is_triangle_known(channel, upper_left, triangle);
    // The corner at the right angle, and where the two others lie from it.
    ivec2 first = upper_left + ivec2(triangle, triangle + channel * grid_points().y);
    ivec2 beside = ivec2(1 - 2 * triangle, 0), below = beside.yx;
    vec2 from_corner = triangle == 0 ? within : 1.0 - within;
    vec4 at_corner = fetched(paths, first);
    vec4 along_row = fetched(paths, first + beside) - at_corner, along_column = fetched(paths, first + below) - at_corner;
    path[channel] = interpolated(at_corner, along_row, along_column, from_corner);
    float to_right = float(1 - 2 * triangle);
    across_and_down[channel] = to_right * vec4(along_row.xy * cells_per_pixel.x, along_column.xy * cells_per_pixel.y);
    vec4 bend_there = fetched(bends, first);
    bend[channel] = interpolated(
        bend_there, fetched(bends, first + beside) - bend_there, fetched(bends, first + below) - bend_there, from_corner);
    vec4 mixed = fetched(mixed_bends_and_ranges, first);
    mixed_bend[channel] = interpolated(
        mixed, fetched(mixed_bends_and_ranges, first + beside) - mixed, fetched(mixed_bends_and_ranges, first + below) - mixed,
        from_corner).xy;
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
    Cell of_cell = cell_at(upper_left);
    if (of_cell.is_covered)
        return;
    cell = vec2(upper_left);
    range = of_cell.range;
    samples_per_axis = of_cell.samples_per_axis;
    is_direct = of_cell.is_direct;
    filled = of_cell.is_filled ? 1.0 : 0.0;
    find_channel(0, upper_left, cells_per_pixel);
#if CHANNELS == 3
    find_channel(1, upper_left, cells_per_pixel);
    find_channel(2, upper_left, cells_per_pixel);
#endif
    if (!shade())
        return;
    imageStore(colour_image, texel, vec4(light, alpha));
    imageStore(status_image, texel, uvec4(worst));
    if (with_source)
        imageStore(source_image, texel, vec4(seen_at, 0.0, 0.0));
}
