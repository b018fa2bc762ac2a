// Cells of the warp grid that an inset fills; cells.frag writes the textures.

const float INSET_SLACK_PX = 6.0;  // how far paths bulge within a cell
const float COVERED = 2.0 * MISSING;  // the range of a cell that the next sharper picture fills

// Whether all that a cell may show lies inside a picture, for all channels.
bool is_filled(sampler2D paths, sampler2D ranges, ivec2 upper_left, vec2 picture_size_px)
{
    int rows = textureSize(paths, 0).y / CHANNELS;
    bool filled = true;
    for (int k = 0; k < 4 * CHANNELS; ++k) {
        ivec2 cell = upper_left + ivec2(0, k / 4 * rows);
        vec4 path = fetched(paths, cell + ivec2(k % 2, k % 4 / 2));
        vec2 range = fetched(ranges, cell).zw;
        range = range.x < 0.0 ? -1.0 - range : range;
        vec2 one = path.xy + range.x * path.zw, other = path.xy + range.y * path.zw;
        bool inside = all(greaterThan(min(one, other), vec2(INSET_SLACK_PX))) &&
                      all(lessThan(max(one, other), picture_size_px - INSET_SLACK_PX));
        filled = filled && (inside || range.x == COVERED);
    }
    return filled;
}
