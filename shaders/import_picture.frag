#version 410
#include "conventions.glsl"
#include "srgb.glsl"
// Takes over a picture that other software drew: its colour, and 1 / depth from the depth that it stored.

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
uniform vec2 layers;      // of colour and depth, where they are in arrays
uniform vec4 scale;    // of colour and alpha
uniform float opaque;  // 1 for a picture without alpha
uniform bool bottom_first;
uniform bool in_metres;
uniform vec2 inverse_depth_of_0_and_1;  // where not in metres; runs evenly between them
uniform vec2 limits;                    // of the stored depth of a surface; NaN lies outside them
uniform float nothing;                  // within them, on the far plane
#if INSET
uniform sampler2D wider;  // the picture around the inset; gives linear light
uniform sampler2D wider_inverse_depth;
uniform vec4 wider_from_inset;  // scale and offset of pixels
uniform float border_px;
uniform bool shares_depth;
uniform bool decodes;
#else
const bool decodes = DECODE == 1;  // a program for each: most pictures are not decoded here, which costs time
#endif

const float LARGEST = 65504.0;  // half float; an infinite texel would spoil all samples around it

vec4 within_half_floats(vec4 value)
{
    // By its bits: compilers may take isnan for false.
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
    // Not texelFetch: it would decode a texture of sRGB.
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
    // Both pictures are drawn from one place, so that the same is seen in one direction, whatever its depth.
    vec2 place = (gl_FragCoord.xy * wider_from_inset.xy + wider_from_inset.zw) / vec2(textureSize(wider, 0));
    vec2 to_edge = min(gl_FragCoord.xy, vec2(size_px) - gl_FragCoord.xy) - 0.5;
    colour = mix(texture(wider, place), colour, smoothstep(0.0, border_px, min(to_edge.x, to_edge.y)));
    inverse_depth = shares_depth ? texture(wider_inverse_depth, place).r : inverse_depth;
#endif
}
