#version 430
#include "conventions.glsl"
#include "bend.glsl"
// What a display shows: the colour of the intermediate image where each pixel's bent ray meets it.
//
// Written for software renderers too: a texture read at normalised coordinates costs them less than texelFetch, and
// outputs that nobody asked for are not compiled in.

uniform sampler2D bend[CHANNELS];
uniform vec4 texture_from_display[CHANNELS];  // scale, offset
uniform vec4 display_from_fragment;  // scale, offset
#if ROWS
uniform sampler2D row_transforms;  // three texels in each row
#else
uniform vec4 image_from_field[3];
#endif
uniform sampler2D picture;
uniform sampler2D inverse_depth;
uniform sampler2D ranges;
uniform vec4 lens;
uniform vec3 background;

flat in vec2 per_texel;  // of picture and inverse_depth
flat in vec2 whole_range;  // of inverse depth

layout(location = 0) out vec4 colour;
#if WITH_STATUS
layout(location = 1) out uint worst_status;
#endif
#if WITH_SOURCE
layout(location = 2) out vec2 source;
#endif

const float NOWHERE = uintBitsToFloat(0x7fc00000u);

#include "march.glsl"

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

// The mean over a display pixel, whose sides appear in the image as `across` and `down`.
vec3 filtered_colour(vec2 pixel, vec2 across, vec2 down)
{
#if TAPS == 1
    return colour_at(pixel);
#else
    vec3 sum = vec3(0.0);
    for (int i = 0; i < TAPS * TAPS; ++i) {
        vec2 place = (vec2(i % TAPS, i / TAPS) + 0.5) / float(TAPS) - 0.5;
        sum += colour_at(pixel + place.x * across + place.y * down);
    }
    return sum / float(TAPS * TAPS);
#endif
}

vec4 ray_in_image_frame(int channel, vec2 display_pixel)
{
    vec4 place = texture_from_display[channel];
    vec4 ray = texture(bend[channel], display_pixel * place.xy + place.zw);
#if ROWS
    int row = int(display_pixel.y);
    vec4 x = texelFetch(row_transforms, ivec2(0, row), 0);
    vec4 y = texelFetch(row_transforms, ivec2(1, row), 0);
    vec4 z = texelFetch(row_transforms, ivec2(2, row), 0);
    return seen_from(ray, x, y, z);
#else
    return seen_from(ray, image_from_field[0], image_from_field[1], image_from_field[2]);
#endif
}

void main()
{
    vec2 display_pixel = gl_FragCoord.xy * display_from_fragment.xy + display_from_fragment.zw;
    colour = vec4(0.0, 0.0, 0.0, 1.0);
    vec2 size = vec2(textureSize(picture, 0));
    int worst = SEEN;
    vec2 seen_at;
    for (int channel = 0; channel < CHANNELS; ++channel) {
        vec4 ray = ray_in_image_frame(channel, display_pixel);
        vec2 at_infinity = pixel_of_tangents(ray.xy, lens);
        vec2 across = dFdx(at_infinity), down = dFdy(at_infinity);
        bool at_hole = any(isnan(across + down));
        bool lost = any(isnan(ray));

        vec2 pixel;
        vec2 shift = pixel_shift_of_offset(ray.zw, lens);
        int status = follow(lost ? vec2(0.0) : at_infinity, lost ? vec2(0.0) : shift, pixel);
        bool inside = all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThanEqual(pixel, size));
        status = lost ? NO_RAY : (inside ? status : OUTSIDE);
        bool found = status <= DISOCCLUDED;

        vec3 sampled = filtered_colour(pixel, at_hole ? vec2(0.0) : across, at_hole ? vec2(0.0) : down);
        vec3 share = CHANNELS == 1 ? vec3(1.0) : vec3(equal(ivec3(0, 1, 2), ivec3(channel)));
        colour.rgb += share * (found ? sampled : background);
        worst = max(worst, status);
        seen_at = channel == CHANNELS / 2 ? (found ? pixel : vec2(NOWHERE)) : seen_at;
    }
#if WITH_STATUS
    worst_status = uint(worst);
#endif
#if WITH_SOURCE
    source = seen_at;
#endif
}
