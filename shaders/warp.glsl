// The colour of a display pixel: the intermediate image's colour where the pixel's bent ray meets it.
//
// warp.frag and warp.comp run it for each pixel. Before including it they define, for the pixel's position in a cell of
// the warp grid: grid_place, cell, range, samples_per_axis, is_direct, filled, nearest_shown, is_backdrop, is_needed,
// and with UNIFORMITY panel_place; for each channel: path, bend, mixed_bend, known; and the function sides_of_pixel,
// which returns the sides of a display pixel in the image.
//
// It is written for software renderers too, in which a texture read at normalised coordinates costs less than a fetch.

TEXTURE(1) picture;  // samples are linear light
TEXTURE(2) inverse_depth;
#ifndef MESH_WARP  // mesh_warp.glsl has a uniform block and the depths of a depth buffer
#define INVERSE_DEPTHS(texels) texels
#define NOWHERE uintBitsToFloat(0x7fc00000u)
uniform vec3 background;  // linear light
uniform float opaque;     // 1 for a picture without alpha
uniform bool is_inset;           // true for a sharper picture of a part, drawn over the wider picture
uniform vec4 widest_from_inset;  // scale and offset of pixels
#endif
#if ENCODING == TABLE
uniform sampler2D code_of_light;  // codes as a function of the fourth root of the light, from 0 to 1
#endif
#if UNIFORMITY
uniform sampler2D uniformity;  // factors of the light
#endif

#if OVERLAYS
uniform int overlay_count;
uniform sampler2D overlays[MAX_OVERLAYS];
uniform vec3 overlay_place[3 * MAX_OVERLAYS];  // rows from image pixels to positions on a quad, times its inverse depth
#endif

vec2 size_px, per_texel;  // size of the image, and its inverse

#include "march.glsl"

// Difference of a quadratic from its linear interpolation over a triangle, by second differences between grid points.
vec2 missed_by_triangles(int channel)
{
    vec2 place = grid_place - cell;
    vec2 share = place * (1.0 - place);
    float mixed = place.x + place.y < 1.0 ? place.x * place.y : (1.0 - place.x) * (1.0 - place.y);
    return mixed * mixed_bend[channel] - 0.5 * (share.x * bend[channel].xy + share.y * bend[channel].zw);
}

vec4 light_at(vec2 pixel, float inverse, float half_px)
{
    vec2 place = is_direct ? pixel : place_on_surface(pixel, inverse, half_px);
    return sampled(picture, place * per_texel);
}

// Mean light over a display pixel with sides `across` and `down` in the image.
vec4 filtered_light(vec2 pixel, vec2 across, vec2 down, float inverse, float half_px)
{
    // The loop is tested at its end: software renderers run one extra iteration of a loop that is tested at its head.
    vec4 sum = vec4(0.0);
    float i = 0.0, count = samples_per_axis * samples_per_axis;
    do {
        float row = floor((i + 0.5) / samples_per_axis);
        vec2 place = (vec2(i - row * samples_per_axis, row) + 0.5) / samples_per_axis - 0.5;
        sum += light_at(pixel + place.x * across + place.y * down, inverse, half_px);
        i += 1.0;
    } while (i < count);
    return sum / count;
}

#if OVERLAYS
// Position where a ray meets an overlay's quad, and its inverse depth, 1/m: negative behind the viewer.
vec3 place_on_quad(int k, vec2 at_infinity, vec2 shift)
{
    vec3 row_x = overlay_place[3 * k], row_y = overlay_place[3 * k + 1], row_w = overlay_place[3 * k + 2];
    // The plane's inverse depth is linear in the pixel, and the pixel is linear in the inverse depth.
    float inverse = dot(row_w, vec3(at_infinity, 1.0)) / (1.0 - dot(row_w.xy, shift));
    vec3 pixel = vec3(at_infinity + inverse * shift, 1.0);
    return vec3(vec2(dot(row_x, pixel), dot(row_y, pixel)) / dot(row_w, pixel), inverse);
}

// Sample filtered over a pixel with these sides; textureGrad crashes LLVM 15 in Mesa's compute shaders.
vec4 sampled_over(IMAGE image, vec2 place, vec2 across, vec2 down)
{
    vec2 size = vec2(size_of(image)), right = across * size, below = down * size;
    return textureLod(READ(image, between_texels), place, 0.5 * log2(max(dot(right, right), dot(below, below))));
}

// Premultiplied light of an overlay, with smooth edges; 0 outside its quad.
vec4 overlay_light(int k, vec2 at_infinity, vec2 shift, vec2 across, vec2 down)
{
    vec3 place = place_on_quad(k, at_infinity, shift);
    vec2 right = place_on_quad(k, at_infinity + across, shift).xy - place.xy;
    vec2 below = place_on_quad(k, at_infinity + down, shift).xy - place.xy;
    vec2 covered = clamp(min(place.xy, 1.0 - place.xy) / (abs(right) + abs(below)) + 0.5, 0.0, 1.0);
    vec4 light = sampled_over(overlays[k], place.xy, right, below);
    return place.z > 0.0 ? covered.x * covered.y * light : vec4(0.0);
}
#endif

vec3 code_of(vec3 light)
{
#if ENCODING == SRGB
    return srgb_of_linear(light);
#elif ENCODING == TABLE
    float last = float(textureSize(code_of_light, 0).x - 1);
    vec3 place = (0.5 + last * sqrt(sqrt(clamp(light, 0.0, 1.0)))) / (last + 1.0);
    return vec3(sampled(code_of_light, vec2(place.r, 0.5)).r, sampled(code_of_light, vec2(place.g, 0.5)).g,
                sampled(code_of_light, vec2(place.b, 0.5)).b);
#else
    return light;
#endif
}

vec3 light = vec3(0.0);
float alpha = 0.0;
int worst = SEEN;
vec2 seen_at = vec2(0.0);

// Called with constants, because a loop that is not unrolled would index the interpolants at run time.
void add_channel(const int channel)
{
    bool lost = known[channel] == 0.0;
    vec2 at_infinity = lost ? vec2(0.0) : path[channel].xy + missed_by_triangles(channel);
    vec2 shift = lost ? vec2(0.0) : path[channel].zw;
    vec2 pixel;
    float inverse = 0.0, half_px = 0.0;
    int status = SEEN;
    if (is_direct) {
        // All surfaces of the image along the path lie within DIRECT_PX.
        vec2 nearby = at_infinity + 0.5 * (range.x + range.y) * shift;
        pixel = at_infinity + inverse_depth_at(nearby) * shift;
    } else {
        status = march(at_infinity, shift, is_needed ? range : range.xx, pixel, inverse, half_px);
        status = inverse > nearest_shown ? DISOCCLUDED : status;
    }
    float margin = is_inset ? 0.5 : 0.0;
    bool inside = all(greaterThanEqual(pixel, vec2(margin))) && all(lessThanEqual(pixel, size_px - margin));
    inside = inside || filled == 1.0;  // never a hole, whatever the depths are
    status = lost ? NO_RAY : (inside ? status : OUTSIDE);
    bool found = status <= DISOCCLUDED;

    vec2 across, down;
    sides_of_pixel(channel, across, down);
    vec4 light_there = filtered_light(pixel, across, down, inverse, half_px);
    vec3 share = CHANNELS == 1 ? vec3(1.0) : vec3(equal(ivec3(0, 1, 2), ivec3(channel)));
    vec4 seen = found ? vec4(light_there.rgb, max(light_there.a, opaque)) : vec4(background, opaque);
#if OVERLAYS
    for (int k = 0; k < overlay_count; ++k) {
        vec4 over = overlay_light(k, at_infinity, shift, across, down);
        seen = lost ? seen : over + (1.0 - over.a) * seen;
    }
#endif
    light += share * seen.rgb;
    alpha = channel == CHANNELS / 2 ? seen.a : alpha;
    worst = max(worst, status);
    seen_at = channel == CHANNELS / 2 ? (found ? pixel : vec2(NOWHERE)) : seen_at;
}

// Shade the pixel; false if it is not drawn, because the wider picture around an inset, or the picture in front of a
// backdrop, is already there.
bool shade()
{
    size_px = vec2(size_of(picture));
    per_texel = 1.0 / size_px;
    add_channel(0);
#if CHANNELS == 3
    add_channel(1);
    add_channel(2);
#endif
    seen_at = is_inset ? seen_at * widest_from_inset.xy + widest_from_inset.zw : seen_at;
#if UNIFORMITY
    light *= sampled(uniformity, panel_place).rgb;
#endif
    light = code_of(light);
    return is_backdrop ? is_needed && worst == SEEN : !is_inset || worst <= DISOCCLUDED;
}
