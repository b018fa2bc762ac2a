// How the warp and the passes before it read textures: targets that lack one of these have another path here.

// The four texels around a corner between them, of the first component: lower left, lower right, upper right, upper left.
vec4 gathered(sampler2D image, vec2 shared_corner)
{
    return textureGather(image, shared_corner);
}

vec4 fetched(sampler2D image, ivec2 texel)
{
    return texelFetch(image, texel, 0);
}

// By the image's own filter, from its finest level: outside of loops and branches too, where no derivatives are defined.
vec4 sampled(sampler2D image, vec2 place)
{
    return textureLod(image, place, 0.0);
}

// Filtered over a pixel with these sides. Not by textureGrad, which ends LLVM 15 in compute shaders of Mesa.
vec4 sampled_over(sampler2D image, vec2 place, vec2 across, vec2 down)
{
    vec2 size = vec2(textureSize(image, 0)), right = across * size, below = down * size;
    return textureLod(image, place, 0.5 * log2(max(dot(right, right), dot(below, below))));
}
