// Texture reads of the warp and the passes before it, with alternatives for targets that lack one of the functions.

// Vulkan, Metal, Direct3D and WebGPU separate textures and samplers.
#ifdef VULKAN
#define IMAGE texture2D
#define READ(image, kind) sampler2D(image, kind)
layout(binding = 4) uniform sampler between_texels;  // linear, clamped to the edge
layout(binding = 5) uniform sampler nearest_texel;   // nearest, clamped to the edge
#else
#define IMAGE sampler2D
#define READ(image, kind) image
#endif
// OpenGL 4.1 and WebGL 2 do not allow binding numbers in a shader's text.
#if defined(VULKAN) || __VERSION__ >= 420 || __VERSION__ == 310 || __VERSION__ == 320
#define TEXTURE(number) layout(binding = number) uniform IMAGE
#else
#define TEXTURE(number) uniform IMAGE
#endif

ivec2 size_of(IMAGE image)
{
    return textureSize(READ(image, nearest_texel), 0);
}

vec4 fetched(IMAGE image, ivec2 texel)
{
    return texelFetch(READ(image, nearest_texel), texel, 0);
}

// First components of the four texels around a shared corner: lower left, lower right, upper right, upper left.
vec4 gathered(IMAGE image, vec2 shared_corner)
{
#ifdef CORNERS  // a texture with the four texels around each corner, one texel larger: one read, not four
    vec2 count = vec2(size_of(CORNERS));
    return textureLod(READ(CORNERS, nearest_texel), (round(shared_corner * (count - 1.0)) + 0.5) / count, 0.0);
#elif __VERSION__ == 300 || defined(NO_GATHER)  // WebGL 2, and naga, which knows no textureGather in GLSL
    ivec2 last = size_of(image) - 1, corner = ivec2(round(shared_corner * vec2(last + 1)));
    ivec2 low = clamp(corner - 1, ivec2(0), last), high = clamp(corner, ivec2(0), last);
    return vec4(fetched(image, ivec2(low.x, high.y)).x, fetched(image, high).x, fetched(image, ivec2(high.x, low.y)).x,
                fetched(image, low).x);
#else
    return textureGather(READ(image, nearest_texel), shared_corner);
#endif
}

// Sample with the image's filter from its finest level, also in loops and branches, where derivatives are undefined.
vec4 sampled(IMAGE image, vec2 place)
{
    return textureLod(READ(image, between_texels), place, 0.0);
}

// Sample the nearest texel, without a filter.
vec4 nearest_sampled(IMAGE image, vec2 place)
{
    return textureLod(READ(image, nearest_texel), place, 0.0);
}
