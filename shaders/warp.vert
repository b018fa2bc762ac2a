#version 410
#include "texels.glsl"
#include "cell_notes.glsl"
#include "warp_cell.glsl"
// The cells of a warp grid as two triangles each; cells that another program draws (sampled directly, or marched) have
// no area.

uniform bool top_row_first;

out vec2 grid_place;
#if UNIFORMITY
out vec2 panel_place;  // position from 0 to 1
#endif
out vec4 path[CHANNELS];
out vec4 bend[CHANNELS];
out vec2 mixed_bend[CHANNELS];
flat out float known[CHANNELS];  // 1 if the triangle's three points have rays
flat out vec2 cell;
flat out vec2 range;  // range of inverse depth along the cell's paths
flat out float samples_per_axis;
flat out float filled;  // 1 if the wider picture around an inset is not drawn here
flat out float nearest_shown;  // inverse depth
invariant gl_Position;  // several programs draw the cells of one picture, which must join without holes

void main()
{
    ivec2 points = grid_points();
    int index = gl_VertexID / 4, corner = gl_VertexID % 4;
    ivec2 upper_left = ivec2(index % (points.x - 1), index / (points.x - 1)), point = upper_left + ivec2(corner % 2, corner / 2);
    for (int channel = 0; channel < CHANNELS; ++channel) {
        ivec2 texel = point + ivec2(0, channel * points.y);
        path[channel] = fetched(paths, texel);
        bend[channel] = fetched(bends, texel);
        mixed_bend[channel] = fetched(mixed_bends_and_ranges, texel).xy;
        known[channel] = is_triangle_known(channel, upper_left, corner / 3);
    }
    Cell of_cell = cell_at(mixed_bends_and_ranges, upper_left);
    Cell front = MARCH == 0 ? of_cell : cell_at(front_ranges, upper_left);  // only marched cells show a backdrop
    range = of_cell.range;
    samples_per_axis = of_cell.samples_per_axis;
    filled = of_cell.is_filled ? 1.0 : 0.0;
    nearest_shown = nearest_shown_in(front);
    cell = vec2(upper_left);
    grid_place = vec2(point);
#if UNIFORMITY
    panel_place = vec2(point) / vec2(points - 1);
#endif
    vec2 place = 2.0 * vec2(point) / vec2(points - 1) - 1.0;
    bool is_drawn_here = !of_cell.is_covered && of_cell.is_direct == (MARCH == 0);
    is_drawn_here = is_backdrop ? !front.is_covered && !front.is_direct : is_drawn_here;
    gl_Position = is_drawn_here ? vec4(place.x, top_row_first ? place.y : -place.y, 0.0, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);
}
