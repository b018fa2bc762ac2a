#version 430
// One triangle over the whole target, and what all pixels of a warp share.

uniform sampler2D picture;
uniform sampler2D ranges;
uniform sampler2D coarse_ranges;  // of inverse depth, few texels

flat out vec2 size_px;
flat out vec2 per_texel;
flat out vec2 per_px_of_tiles;
flat out vec2 whole_range;

void main()
{
    size_px = vec2(textureSize(picture, 0));
    per_texel = 1.0 / size_px;
    per_px_of_tiles = 1.0 / vec2(TILE * textureSize(ranges, 0));
    ivec2 size = textureSize(coarse_ranges, 0);
    whole_range = texelFetch(coarse_ranges, ivec2(0), 0).xy;
    for (int i = 1; i < size.x * size.y; ++i) {
        vec2 other = texelFetch(coarse_ranges, ivec2(i % size.x, i / size.x), 0).xy;
        whole_range = vec2(min(whole_range.x, other.x), max(whole_range.y, other.y));
    }
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
