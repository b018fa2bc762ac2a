#version 410
// The smallest and the largest value in each tile of an image: of inverse depths, or of smaller tiles' ranges.

uniform sampler2D values;

layout(location = 0) out vec2 range;

void main()
{
    ivec2 size = textureSize(values, 0);
    ivec2 first = ivec2(gl_FragCoord.xy) * TILE;
    ivec2 end = min(first + TILE, size);
    vec4 low = vec4(uintBitsToFloat(0x7f800000u));
    vec4 high = vec4(0.0);
    for (int y = first.y; y < end.y; y += 2) {
        for (int x = first.x; x < end.x; x += 2) {
            vec2 shared_corner = vec2(x + 1, y + 1) / vec2(size);
            vec4 four = textureGather(values, shared_corner);
            low = min(low, four);
            high = max(high, OF_RANGES == 1 ? textureGather(values, shared_corner, 1) : four);
        }
    }
    range = vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}
