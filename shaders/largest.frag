#version 430
// The largest value in each tile of a one-channel image of values >= 0; the tile's side is even.

uniform sampler2D values;
uniform int tile;

layout(location = 0) out float largest;

void main()
{
    ivec2 size = textureSize(values, 0);
    ivec2 first = ivec2(gl_FragCoord.xy) * tile;
    ivec2 end = min(first + tile, size);
    vec4 four = vec4(0.0);
    for (int y = first.y; y < end.y; y += 2) {
        for (int x = first.x; x < end.x; x += 2) {
            four = max(four, textureGather(values, vec2(x + 1, y + 1) / vec2(size)));
        }
    }
    largest = max(max(four.x, four.y), max(four.z, four.w));
}
