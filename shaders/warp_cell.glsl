// Data of a cell of the warp grid: outputs of cells.frag, read for warp.vert and warp.comp.

uniform sampler2D paths;  // see cells.frag; channels are stacked vertically
uniform sampler2D bends;
uniform sampler2D mixed_bends_and_ranges;
uniform float most_samples_per_axis;  // samples of a display pixel

// The backdrop, an older picture, is drawn where the picture in front is DISOCCLUDED, which never happens in direct
// cells.
uniform bool is_backdrop;
uniform sampler2D front_ranges;

// Corners of a cell's two triangles, cut from the upper right to the lower left: the same points in both shaders.
const ivec2 CORNERS[6] = ivec2[](ivec2(0, 0), ivec2(1, 0), ivec2(0, 1), ivec2(1, 0), ivec2(1, 1), ivec2(0, 1));

struct Cell {
    vec2 range;  // range of inverse depth along the paths
    float samples_per_axis;
    bool is_direct;   // the image's depth moves its pixels by less than DIRECT_PX
    bool is_covered;  // a sharper picture fills it
    bool is_filled;   // an inset fills it: the wider picture is not drawn here
};

ivec2 grid_points()
{
    return textureSize(paths, 0) / ivec2(1, CHANNELS);
}

Cell cell_at(sampler2D ranges, ivec2 upper_left)
{
    Cell cell = Cell(vec2(MISSING, 0.0), 1.0, true, false, true);
    for (int channel = 0; channel < CHANNELS; ++channel) {
        float samples;
        bool is_filled;
        vec2 range = fetched(ranges, upper_left + ivec2(0, channel * grid_points().y)).zw;
        range = without_notes(range, samples, is_filled);
        cell.is_filled = cell.is_filled && is_filled;
        cell.is_covered = cell.is_covered || range.x > 0.5 * MISSING;
        cell.samples_per_axis = max(cell.samples_per_axis, min(samples, most_samples_per_axis));
        cell.is_direct = cell.is_direct && range.x >= range.y;
        cell.range = vec2(min(cell.range.x, min(range.x, range.y)), max(cell.range.y, max(range.x, range.y)));
    }
    return cell;
}

// Largest inverse depth that a backdrop shows: it must lie behind the surface that hides it.
float nearest_shown_in(Cell front)
{
    return is_backdrop ? 0.5 * (front.range.x + front.range.y) : MISSING;
}

// 1 if the three points of a cell's first or second triangle have rays.
float is_triangle_known(int channel, ivec2 upper_left, int triangle)
{
    float known = 1.0;
    for (int k = 3 * triangle; k < 3 * triangle + 3; ++k) {
        vec4 path = fetched(paths, upper_left + CORNERS[k] + ivec2(0, channel * grid_points().y));
        known = path.x < 0.5 * MISSING ? known : 0.0;
    }
    return known;
}
