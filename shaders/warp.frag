#version 430
#include "conventions.glsl"
// Where a bent ray meets what the intermediate image shows, and its colour there: rendering/warped_image.py has the words.
//
// Written for software renderers too: they run both sides of a branch and at least one turn of a loop, and a texture
// read at normalised coordinates costs them less than texelFetch.

uniform sampler2D bend;  // a, b, c, d
uniform sampler2D picture;
uniform sampler2D inverse_depth;
uniform vec4 lens;
uniform vec3 background;

flat in vec2 per_bend_texel;
flat in vec2 per_texel;  // of picture and inverse_depth
flat in float largest;  // inverse depth in the whole image

layout(location = 0) out vec4 colour_and_status;
layout(location = 1) out vec2 source;

const float NOWHERE = uintBitsToFloat(0x7fc00000u);

float nearest_inverse_depth(vec2 pixel)
{
    return texture(inverse_depth, pixel * per_texel).r;
}

float smooth_inverse_depth(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 shared_corner = (base + 1.0) * per_texel;
    vec4 taps = textureGather(inverse_depth, shared_corner);  // lower left, lower right, upper right, upper left
    float high = max(max(taps.x, taps.y), max(taps.z, taps.w));
    float low = min(min(taps.x, taps.y), min(taps.z, taps.w));
    weight = high - low > SURFACE_STEP * high ? step(0.5, weight) : weight;
    return mix(mix(taps.w, taps.z, weight.x), mix(taps.x, taps.y, weight.x), weight.y);
}

vec3 colour_at(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 texel = (base + 0.5) * per_texel;
    vec3 upper = mix(texture(picture, texel).rgb, textureOffset(picture, texel, ivec2(1, 0)).rgb, weight.x);
    vec3 lower = mix(
        textureOffset(picture, texel, ivec2(0, 1)).rgb, textureOffset(picture, texel, ivec2(1, 1)).rgb, weight.x
    );
    return mix(upper, lower, weight.y);
}

int follow(vec2 at_infinity, vec2 shift, out vec2 pixel)
{
    float seen = nearest_inverse_depth(at_infinity + largest * shift);
    pixel = at_infinity + seen * shift;
    vec2 previous;
    float previously_seen;
    int steps = 0;
    bool settled;
    do {
        previous = pixel;
        previously_seen = seen;
        seen = smooth_inverse_depth(pixel);
        pixel = at_infinity + seen * shift;
        settled = distance(pixel, previous) < SETTLED_PX;
    } while (!settled && ++steps < MAX_STEPS);
    pixel = !settled && seen < previously_seen ? previous : pixel;
    return settled ? SEEN : DISOCCLUDED;
}

void main()
{
    vec4 ray = texture(bend, gl_FragCoord.xy * per_bend_texel);
    bool lost = any(isnan(ray));
    ray = lost ? vec4(0.0) : ray;
    vec2 pixel;
    int status = follow(pixel_of_tangents(ray.xy, lens), pixel_shift_of_offset(ray.zw, lens), pixel);
    vec2 size = vec2(textureSize(picture, 0));
    bool inside = all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThanEqual(pixel, size));
    status = lost ? NO_RAY : (inside ? status : OUTSIDE);
    bool found = inside && !lost;
    colour_and_status = vec4(found ? colour_at(pixel) : background, float(status) / 255.0);
    source = found ? pixel : vec2(NOWHERE);
}
