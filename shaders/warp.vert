#version 410
#include "insets.glsl"
// The cells of a warp grid as two triangles each, cut from the upper right to the lower left; those that the program is
// for (sampled directly, or marched), the others without area.

uniform sampler2D paths;  // see cells.frag
uniform sampler2D bends;
uniform sampler2D mixed_bends_and_ranges;
uniform bool top_row_first;
uniform bool is_inset;
uniform sampler2D picture;
uniform float minified_samples_per_axis;  // of a display pixel where the map minifies

out vec2 grid_place;
#if UNIFORMITY
out vec2 panel_place;  // from 0 to 1
#endif
out vec4 path[CHANNELS];
out vec4 bend[CHANNELS];
out vec2 mixed_bend[CHANNELS];
flat out float known[CHANNELS];  // 1 if the triangle's three points have rays
flat out vec2 cell;
flat out vec2 range;  // of inverse depth along the cell's paths
flat out float samples_per_axis;
flat out float filled;  // 1 if an inset's wider picture is not drawn here
invariant gl_Position;  // several programs draw the cells of one picture, which must meet without holes

const ivec2 CORNERS[6] = ivec2[](ivec2(0, 0), ivec2(1, 0), ivec2(0, 1), ivec2(1, 0), ivec2(1, 1), ivec2(0, 1));

void main()
{
    ivec2 points = textureSize(paths, 0) / ivec2(1, CHANNELS);
    int index = gl_VertexID / 6;
    ivec2 upper_left = ivec2(index % (points.x - 1), index / (points.x - 1));
    ivec2 point = upper_left + CORNERS[gl_VertexID % 6];
    range = vec2(MISSING, 0.0);
    bool direct = true, minified = false, skipped = false;
    for (int channel = 0; channel < CHANNELS; ++channel) {
        ivec2 texel = point + ivec2(0, channel * points.y);
        path[channel] = texelFetch(paths, texel, 0);
        known[channel] = 1.0;
        for (int k = 0; k < 3; ++k) {
            ivec2 other = upper_left + CORNERS[gl_VertexID % 6 / 3 * 3 + k] + ivec2(0, channel * points.y);
            known[channel] = texelFetch(paths, other, 0).x < 0.5 * MISSING ? known[channel] : 0.0;
        }
        bend[channel] = texelFetch(bends, texel, 0);
        mixed_bend[channel] = texelFetch(mixed_bends_and_ranges, texel, 0).xy;
        vec2 of_cell = texelFetch(mixed_bends_and_ranges, upper_left + ivec2(0, channel * points.y), 0).zw;
        skipped = skipped || of_cell.x > 0.5 * MISSING;
        minified = minified || of_cell.x < 0.0;
        of_cell = of_cell.x < 0.0 ? -1.0 - of_cell : of_cell;
        direct = direct && of_cell.x >= of_cell.y;
        range = vec2(min(range.x, min(of_cell.x, of_cell.y)), max(range.y, max(of_cell.x, of_cell.y)));
    }
    filled = 0.0;
    if (is_inset)
        filled = is_filled(paths, mixed_bends_and_ranges, upper_left, vec2(textureSize(picture, 0))) ? 1.0 : 0.0;
    samples_per_axis = minified ? minified_samples_per_axis : 1.0;
    cell = vec2(upper_left);
    grid_place = vec2(point);
#if UNIFORMITY
    panel_place = vec2(point) / vec2(points - 1);
#endif
    vec2 place = 2.0 * vec2(point) / vec2(points - 1) - 1.0;
    bool is_drawn_here = !skipped && direct == (MARCH == 0);
    gl_Position = is_drawn_here ? vec4(place.x, top_row_first ? place.y : -place.y, 0.0, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);
}
