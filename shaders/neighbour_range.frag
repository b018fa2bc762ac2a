#version 430
// The smallest and the largest value in each tile and the eight around it.

uniform sampler2D ranges;

layout(location = 0) out vec2 range;

void main()
{
    ivec2 last = textureSize(ranges, 0) - 1;
    range = texelFetch(ranges, ivec2(gl_FragCoord.xy), 0).xy;
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            vec2 other = texelFetch(ranges, clamp(ivec2(gl_FragCoord.xy) + ivec2(x, y), ivec2(0), last), 0).xy;
            range = vec2(min(range.x, other.x), max(range.y, other.y));
        }
    }
}
