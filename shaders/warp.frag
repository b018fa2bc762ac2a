#version 430
#include "conventions.glsl"
// What a display shows: the colour of the intermediate image where each pixel's bent ray meets it.
//
// Written for software renderers too: a texture read at normalised coordinates costs them less than texelFetch, and
// outputs that nobody asked for are not compiled in.

uniform sampler2D slope_offset[CHANNELS];
uniform vec4 texture_from_fragment[CHANNELS];  // of slope_offset; scale, offset
#if ROWS
uniform sampler2D camera_matrices;  // from the field, for each row of the display; three texels in each row
uniform vec2 row_from_fragment;  // scale, offset
#else
uniform vec4 camera_matrix[3];  // from the field
#endif
uniform sampler2D picture;
uniform sampler2D inverse_depth;
uniform sampler2D ranges;
uniform vec3 background;

flat in vec2 size_px;  // of picture and inverse_depth
flat in vec2 per_texel;
flat in vec2 per_px_of_tiles;  // a texture coordinate of ranges
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
#if SAMPLES_PER_AXIS == 1
    return colour_at(pixel);
#else
    vec3 sum = vec3(0.0);
    for (int i = 0; i < SAMPLES_PER_AXIS * SAMPLES_PER_AXIS; ++i) {
        vec2 place = (vec2(i % SAMPLES_PER_AXIS, i / SAMPLES_PER_AXIS) + 0.5) / float(SAMPLES_PER_AXIS) - 0.5;
        sum += colour_at(pixel + place.x * across + place.y * down);
    }
    return sum / float(SAMPLES_PER_AXIS * SAMPLES_PER_AXIS);
#endif
}

// The ray at a normalised position in a field.
vec4 ray_at(int channel, vec2 position)
{
#if FIELD_BY_TEXELS
    ivec2 size = textureSize(slope_offset[channel], 0);
    vec2 base, weight;
    bilinear_taps(position * vec2(size), base, weight);
    ivec2 first = clamp(ivec2(base), ivec2(0), size - 1), second = clamp(ivec2(base) + 1, ivec2(0), size - 1);
    vec4 upper = mix(texelFetch(slope_offset[channel], first, 0), texelFetch(slope_offset[channel], ivec2(second.x, first.y), 0), weight.x);
    vec4 lower = mix(texelFetch(slope_offset[channel], ivec2(first.x, second.y), 0), texelFetch(slope_offset[channel], second, 0), weight.x);
    return mix(upper, lower, weight.y);
#else
    return texture(slope_offset[channel], position);
#endif
}

void path_of_ray(vec4 ray, out vec2 at_infinity, out vec2 shift)
{
#if ROWS
    int last_row = textureSize(camera_matrices, 0).y - 1;  // helper pixels may lie beyond it
    int row = clamp(int(gl_FragCoord.y * row_from_fragment.x + row_from_fragment.y), 0, last_row);
    vec4 row_u = texelFetch(camera_matrices, ivec2(0, row), 0);
    vec4 row_v = texelFetch(camera_matrices, ivec2(1, row), 0);
    vec4 row_depth = texelFetch(camera_matrices, ivec2(2, row), 0);
    project_ray(ray, row_u, row_v, row_depth, at_infinity, shift);
#else
    project_ray(ray, camera_matrix[0], camera_matrix[1], camera_matrix[2], at_infinity, shift);
#endif
}

void main()
{
    colour = vec4(0.0, 0.0, 0.0, 1.0);
    int worst = SEEN;
    vec2 seen_at;
    for (int channel = 0; channel < CHANNELS; ++channel) {
        vec4 place = texture_from_fragment[channel];
        vec2 at_infinity, shift;
        path_of_ray(ray_at(channel, gl_FragCoord.xy * place.xy + place.zw), at_infinity, shift);
        vec2 across = dFdx(at_infinity), down = dFdy(at_infinity);
        bool at_hole = any(isnan(across + down));
        bool lost = any(isnan(at_infinity + shift));

        vec2 pixel;
        int status = march(lost ? vec2(0.0) : at_infinity, lost ? vec2(0.0) : shift, pixel);
        bool inside = all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThanEqual(pixel, size_px));
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
