#version 410
#include "conventions.glsl"
#include "srgb.glsl"
// Import a picture that other software drew: its colour, and 1 / depth from its stored depth.

#if COLOUR_LAYERS
uniform sampler2DArray stored_colour;
#else
uniform sampler2D stored_colour;
#endif
#if DEPTH_LAYERS
uniform sampler2DArray stored_depth;
#else
uniform sampler2D stored_depth;
#endif
uniform ivec2 size_px;
uniform ivec4 firsts_px;  // first pixels of colour and depth in their textures
uniform vec2 layers;      // layers of colour and depth, if they are in arrays
uniform vec4 scale;    // scale of colour and alpha
uniform float opaque;  // 1 for a picture without alpha
uniform bool bottom_first;
uniform bool in_metres;
uniform vec2 inverse_depth_of_0_and_1;  // if not in metres; linear between them
uniform vec2 limits;                    // limits of a surface's stored depth; NaN is outside
uniform float nothing;                  // background within the limits, as on the far plane
#if INSET
uniform sampler2D wider;  // picture around the inset; samples are linear light
uniform sampler2D wider_inverse_depth;
uniform vec4 wider_from_inset;  // scale and offset of pixels
uniform float border_px;
uniform bool shares_depth;
uniform bool decodes;
#else
const bool decodes = DECODE == 1;  // separate programs, because decoding costs time and most pictures need none
#endif

const float LARGEST = 65504.0;  // largest half float; an infinite texel would spoil all samples around it

vec4 within_half_floats(vec4 value)
{
    // Tested by its bits, because compilers may assume that isnan is false.
    bvec4 is_number = lessThanEqual(floatBitsToUint(value) & 0x7fffffffu, uvec4(0x7f800000u));
    return mix(vec4(0.0), clamp(value, -LARGEST, LARGEST), is_number);
}

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;

void main()
{
    ivec2 texel = ivec2(gl_FragCoord.xy);
    if (bottom_first)
        texel.y = size_px.y - 1 - texel.y;
    // Not texelFetch, which would decode an sRGB texture.
    vec2 in_colour = (vec2(firsts_px.xy + texel) + 0.5) / vec2(textureSize(stored_colour, 0).xy);
    vec2 in_depth = (vec2(firsts_px.zw + texel) + 0.5) / vec2(textureSize(stored_depth, 0).xy);
#if COLOUR_LAYERS
    colour = texture(stored_colour, vec3(in_colour, layers.x));
#else
    colour = texture(stored_colour, in_colour);
#endif
#if DEPTH_LAYERS
    float stored = texture(stored_depth, vec3(in_depth, layers.y)).r;
#else
    float stored = texture(stored_depth, in_depth).r;
#endif
    colour = within_half_floats(scale * colour);
    colour.a = clamp(max(colour.a, opaque), 0.0, 1.0);
    colour.rgb = decodes ? linear_of_srgb(colour.rgb) : colour.rgb;
    bool surface = stored >= limits.x && stored <= limits.y && stored != nothing;
    float between = (1.0 - stored) * inverse_depth_of_0_and_1.x + stored * inverse_depth_of_0_and_1.y;
    inverse_depth = !surface ? 0.0 : in_metres ? 1.0 / stored : max(between, 0.0);
#if INSET
    // Both pictures are drawn from one position, so a direction shows the same point in both, whatever its depth.
    vec2 place = (gl_FragCoord.xy * wider_from_inset.xy + wider_from_inset.zw) / vec2(textureSize(wider, 0));
    vec2 to_edge = min(gl_FragCoord.xy, vec2(size_px) - gl_FragCoord.xy) - 0.5;
    colour = mix(texture(wider, place), colour, smoothstep(0.0, border_px, min(to_edge.x, to_edge.y)));
    inverse_depth = shares_depth ? texture(wider_inverse_depth, place).r : inverse_depth;
#endif
}
