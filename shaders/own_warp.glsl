// Warp of an eye's picture to its panel, for your own renderer in Vulkan, Direct3D, Metal, WebGPU, OpenGL, OpenGL ES or
// WebGL. A `WarpMesh` of wlr_render/warp/warp_mesh.py provides vertices, indices and `image_from_ray`.
//
// Compile it for four stages, each with one of these definitions after "#version 450" (Vulkan, SPIR-V), "420" (OpenGL),
// "310 es" or "300 es": "#define TILES_VERTEX_STAGE", "TILES_FRAGMENT_STAGE", "VERTEX_STAGE", "FRAGMENT_STAGE". For
// WebGPU take own_warp.wgsl, which has the stages as entry points.
// 1. Once per picture: draw 3 vertices to an RG32F target of ceil(width / 8) x ceil(height / 8), the tiles.
// 2. Once per frame: draw the mesh's triangles to a target in an sRGB format, without culling and depth test; in OpenGL
//    with GL_FRAMEBUFFER_SRGB. With three colours, draw three times, each with its own rays and a write mask.
// The picture has an sRGB format too: the sampler decodes and filters linear light, and the target encodes it.
// Written by release/own_warp.py from mesh_warp.glsl and what that includes.

#define SEEN 0
#define DISOCCLUDED 1
#define OUTSIDE 2
#define NO_RAY 3
#define SURFACE_STEP 0.02
#define TILE 8
#define DIRECT_PX 0.05
#define SPACING_PX 1.25
#define MISSING 1e+30
#define CHANNELS 1

#define MESH_WARP
#ifdef GL_ES
precision highp float;
precision highp int;
precision highp sampler2D;
#endif
#if __VERSION__ == 300
#define AT(number)
layout(std140) uniform Warp {
#else
#define AT(number) layout(location = number)
layout(std140, binding = 0) uniform Warp {
#endif
    vec4 image_from_ray[3];  // rows for u depth, v depth and depth
    vec4 clip_from_panel;  // scale, offset of panel_position: (2, -2, -1, 1), upright; in Vulkan (2, 2, -1, -1)
    vec2 inverse_depth_of_0_and_1;  // inverse depths of the depth buffer's 0 and 1, 1/m: StoredDepth.inverse_of_0_and_1
    float nothing;  // depth of the background: StoredDepth.nothing
    float nearest;  // largest inverse depth in the picture, 1/m, or 1 / near
    vec3 background;  // linear light
    float opaque;  // 1 for a picture without alpha
    float most_samples_per_axis;  // WarpMesh.samples_per_axis
};

#if defined(VERTEX_STAGE)
layout(location = 0) in vec2 panel_position;
layout(location = 1) in vec4 vertex_ray;
AT(0) out vec4 ray;
AT(1) out float has_ray;  // 1 if all three vertices have a ray

void main()
{
    // Tested by its bits, because compilers may assume that NaN does not occur.
    bool missing = any(greaterThan(floatBitsToUint(vertex_ray) & 0x7fffffffu, uvec4(0x7f800000u)));
    ray = missing ? vec4(0.0) : vertex_ray;
    has_ray = missing ? 0.0 : 1.0;
    gl_Position = vec4(panel_position * clip_from_panel.xy + clip_from_panel.zw, 0.0, 1.0);
}
#elif defined(TILES_VERTEX_STAGE)
#ifdef VULKAN
#define gl_VertexID gl_VertexIndex
#endif
void main()
{
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
#else

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

#define INVERSE_DEPTHS inverse_depths

// Inverse depths, 1/m, of the values of a depth buffer.
vec4 inverse_depths(vec4 stored)
{
    vec4 between = (1.0 - stored) * inverse_depth_of_0_and_1.x + stored * inverse_depth_of_0_and_1.y;
    return mix(vec4(0.0), max(between, 0.0), notEqual(stored, vec4(nothing)));
}

#ifdef TILES_FRAGMENT_STAGE
TEXTURE(2) depth;
layout(location = 0) out vec2 range;

// Smallest and largest value of an image in the tile at a pixel of the tiles; beyond the border the image repeats.
vec2 range_of_tile(IMAGE values, vec2 tile)
{
    vec2 per_texel = 1.0 / vec2(size_of(values)), first = floor(tile) * float(TILE) + 1.0;
    vec4 low = INVERSE_DEPTHS(gathered(values, first * per_texel)), high = low;
    // Unrolled, because a loop whose bounds depend on the image takes twice as long in software renderers.
    for (int k = 1; k < TILE * TILE / 4; ++k) {
        vec2 shared_corner = first + 2.0 * vec2(k % (TILE / 2), k / (TILE / 2));
        vec4 four = INVERSE_DEPTHS(gathered(values, shared_corner * per_texel));
        low = min(low, four);
        high = max(high, four);
    }
    return vec2(min(min(low.x, low.y), min(low.z, low.w)), max(max(high.x, high.y), max(high.z, high.w)));
}

void main()
{
    range = range_of_tile(depth, gl_FragCoord.xy);
}
#else
// Projection and half-pixel convention of all shaders (docs/conventions.md, "Pixels" and "Rows").
//
// Images are stored with their top row first, on the GPU as in numpy. OpenGL's first row is its lowest, so the
// projection in scene.vert flips y, and nothing else is flipped: window row 0 is the image's top row, and
// gl_FragCoord.xy is the pixel, (0, 0) at the outer corner of the top-left pixel, centres at +0.5.

// Project a ray (a, b, c, d), which passes through (c, d, 0) with tangents (a, b) in some camera frame, into an image:
// its point at inverse depth w appears at at_infinity + w shift. False if the ray does not point forwards in the
// image's frame. The rows of the image's camera matrix give u depth, v depth and depth of a point (x, y, z, 1) of the
// ray's frame.
bool project_ray(vec4 ray, vec4 row_u, vec4 row_v, vec4 row_depth, out vec2 at_infinity, out vec2 shift)
{
    float depth = dot(row_depth.xy, ray.xy) - row_depth.z;
    vec2 forwards = vec2(dot(row_u.xy, ray.xy) - row_u.z, dot(row_v.xy, ray.xy) - row_v.z);
    at_infinity = forwards / (depth > 0.0 ? depth : 1.0);
    vec2 start = vec2(dot(row_u.xy, ray.zw) + row_u.w, dot(row_v.xy, ray.zw) + row_v.w);
    shift = start - (dot(row_depth.xy, ray.zw) + row_depth.w) * at_infinity;
    return depth > 0.0;
}

// Largest singular value: image pixels per display pixel, in the direction where their number is largest.
float largest_stretch(mat2 image_by_display)
{
    float squares = dot(image_by_display[0], image_by_display[0]) + dot(image_by_display[1], image_by_display[1]);
    float area = determinant(image_by_display);
    return sqrt(0.5 * (squares + sqrt(max(squares * squares - 4.0 * area * area, 0.0))));
}

// The four texels around a pixel position: `base` is the upper left texel, `weight` the share of the right, lower
// texels.
void bilinear_taps(vec2 pixel, out vec2 base, out vec2 weight)
{
    base = floor(pixel - 0.5);
    weight = pixel - 0.5 - base;
}

AT(0) in vec4 ray;
AT(1) in float has_ray;
layout(location = 0) out vec4 colour;

// Each ray has its own position and path, which the compositor interpolates between the points of a coarser grid.
const bool is_inset = false, is_backdrop = false, is_needed = true;
const float filled = 0.0, nearest_shown = MISSING;
const vec4 widest_from_inset = vec4(1.0, 1.0, 0.0, 0.0);
const vec2 grid_place = vec2(0.0), cell = vec2(0.0);
vec2 range;
float samples_per_axis;
bool is_direct;
float known[1];
vec4 path[1];
vec4 bend[1];
vec4 sides;  // sides of a display pixel in the picture
vec2 mixed_bend[1];

void sides_of_pixel(const int channel, out vec2 across, out vec2 down)
{
    across = sides.xy;
    down = sides.zw;
}

#define NOWHERE (-1.0)
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

vec2 size_px, per_texel;  // size of the image, and its inverse

// Intersect a ray with the depth of the intermediate image, texel by texel; warp/warp.py states the algorithm.
//
// Needs SURFACE_STEP, TILE, and the pixel shader's `inverse_depth`, `size_px` and `per_texel`. There is one loop with
// the same reads in each iteration, because software renderers execute both sides of a branch. They may leave the loop
// for all neighbours at once, so the variables of the result (meets, met, in_front) must not change once a pixel has
// stopped.

TEXTURE(3) tiles;  // smallest and largest inverse depth of TILE x TILE texels

const float NUDGE_PX = 1e-3;  // texels that a path crosses over a shorter length are skipped
const float MARGIN_PX = float(TILE);
const float UNKNOWN = -1.0;

float inverse_depth_at(vec2 pixel)
{
    return INVERSE_DEPTHS(nearest_sampled(inverse_depth, pixel * per_texel)).x;
}

float smooth_inverse_depth(vec2 pixel)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec2 shared_corner = (base + 1.0) * per_texel;
    vec4 texels = INVERSE_DEPTHS(gathered(inverse_depth, shared_corner));  // lower left, lower right, upper right, upper left
    float high = max(max(texels.x, texels.y), max(texels.z, texels.w));
    float low = min(min(texels.x, texels.y), min(texels.z, texels.w));
    weight = high - low > SURFACE_STEP * high ? step(0.5, weight) : weight;
    return mix(mix(texels.w, texels.z, weight.x), mix(texels.x, texels.y, weight.x), weight.y);
}

// Whether two neighbours are of one surface: the step between them is small, or opens less than half a pixel.
bool is_one_surface(float one, float other, float half_px)
{
    return abs(one - other) <= max(SURFACE_STEP * max(one, other), half_px);
}

// Position at which to read colour near a pixel: of the four texels around it, texels of a surface other than the one
// at this inverse depth are ignored, except a texel within half a pixel of the surface.
vec2 place_on_surface(vec2 pixel, float met, float half_px)
{
    vec2 base, weight;
    bilinear_taps(pixel, base, weight);
    vec4 texels = INVERSE_DEPTHS(gathered(inverse_depth, (base + 1.0) * per_texel));  // in the same order
    vec4 belongs = vec4(lessThanEqual(abs(texels - met), max(SURFACE_STEP * max(texels, met), half_px)));
    vec4 share = belongs * vec4(1.0 - weight.x, weight.xx, 1.0 - weight.x) * vec4(weight.yy, 1.0 - weight.yy);
    float largest = max(max(share.x, share.y), max(share.z, share.w));
    vec2 own = vec2(max(share.y, share.z) == largest, max(share.x, share.y) == largest);
    float row = mix(belongs.z * belongs.w, belongs.x * belongs.y, own.y);
    float column = mix(belongs.x * belongs.w, belongs.y * belongs.z, own.x);
    bool all_belong = belongs.x * belongs.y * belongs.z * belongs.w == 1.0;
    vec2 moved = row == 1.0 ? vec2(weight.x, own.y) : column == 1.0 ? vec2(own.x, weight.y) : own;
    return base + 0.5 + (all_belong || largest == 0.0 ? weight : moved);
}

// Find the position that a ray shows, the inverse depth seen there, and the inverse depth equivalent to half a pixel,
// from the bounds of the inverse depth along its path.
int march(vec2 at_infinity, vec2 shift, vec2 range, out vec2 pixel, out float seen_there, out float half_px)
{
    float px_per_inverse_depth = max(length(shift), 1e-12), one_px = 1.0 / px_per_inverse_depth;
    vec2 nudge = -NUDGE_PX * one_px * shift;
    vec2 ahead = vec2(lessThan(shift, vec2(0.0)));  // 1 where coordinates grow along the path
    vec2 per_shift = (1.0 - 2.0 * ahead) / max(abs(shift), 1e-12);
    vec2 tiles_per_px = 1.0 / (float(TILE) * vec2(size_of(tiles)));

    // The path inside the image and a margin in which the border repeats: a very near texel may start it far outside.
    vec2 from_first = (-MARGIN_PX - at_infinity) * per_shift, from_last = (size_px + MARGIN_PX - at_infinity) * per_shift;
    vec2 enters = max(from_first, from_last), leaves_image = min(from_first, from_last);
    // Widened, so that rounded bounds leave out no depth between them.
    float last = range.x * (1.0 - 1e-6), far_end = max(last, max(leaves_image.x, leaves_image.y));
    float here = min(range.y * (1.0 + 1e-6), min(enters.x, enters.y));
    bool never_enters = here < far_end;
    float before = UNKNOWN, met = here;
    bool in_front = true, meets = false, searching = true;
    do {
        vec2 place = at_infinity + here * shift + nudge;
        vec2 texel = floor(place), tile = floor(place / float(TILE));
        vec2 leaves = (texel + ahead - at_infinity) * per_shift;
        vec2 leaves_tile = ((tile + ahead) * float(TILE) - at_infinity) * per_shift;
        // By rounding, a border that the path has just crossed, or hardly approaches, may lie behind it.
        leaves = mix(leaves, vec2(here - one_px), greaterThanEqual(leaves, vec2(here)));
        leaves_tile = mix(leaves_tile, vec2(here - one_px), greaterThanEqual(leaves_tile, vec2(here)));
        float end = max(max(leaves.x, leaves.y), far_end), end_of_tile = max(max(leaves_tile.x, leaves_tile.y), far_end);
        vec2 bounds = nearest_sampled(tiles, (tile + 0.5) * float(TILE) * tiles_per_px).xy;
        float seen = inverse_depth_at(texel + 0.5);

        bool is_behind = seen > here;
        bool behind_tile = !in_front && bounds.x > here && is_one_surface(bounds.x, bounds.y, 0.5 * one_px);
        bool skips = bounds.y < end_of_tile || behind_tile;
        // At its start the path is in front, or just outside the image, where it has met the border's surface.
        bool joins = before == UNKNOWN || is_one_surface(before, seen, 0.5 * one_px);
        meets = meets || searching && !skips && seen >= end && (!is_behind || in_front && joins);
        bool edge = !meets && !skips && is_behind && !joins;
        met = !searching ? met : meets ? min(seen, here) : edge ? max(seen, before) : met;
        before = skips ? bounds.y : seen;
        in_front = searching && !skips ? !is_behind : in_front;
        here = meets ? here : min(skips ? end_of_tile : end, here * (1.0 - 1e-7));
        searching = !meets && here > far_end;
    } while (searching);
    // Two steps, then the limit to which the steps converge on a plane.
    float second = smooth_inverse_depth(at_infinity + met * shift);
    float third = smooth_inverse_depth(at_infinity + second * shift);
    float first_step = second - met, second_step = third - second;
    bool converges = abs(second_step) < 0.5 * abs(first_step);
    float limit = converges ? third + second_step * second_step / (first_step - second_step) : third;
    bool stays = meets && abs(limit - met) * px_per_inverse_depth < 1.5;
    bool is_outside = never_enters || !meets && in_front && far_end > last;
    met = stays ? limit : met;
    pixel = is_outside ? vec2(-MARGIN_PX) : at_infinity + met * shift;
    seen_there = meets ? met : inverse_depth_at(pixel);
    half_px = 0.5 * one_px;
    return meets ? SEEN : DISOCCLUDED;
}

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

vec3 code_of(vec3 light)
{
    return light;
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
    seen_at = is_inset ? seen_at * widest_from_inset.xy + widest_from_inset.zw : seen_at;
    light = code_of(light);
    return is_backdrop ? is_needed && worst == SEEN : !is_inset || worst <= DISOCCLUDED;
}

void main()
{
    vec2 at_infinity, shift;
    bool forwards = project_ray(ray, image_from_ray[0], image_from_ray[1], image_from_ray[2], at_infinity, shift);
    known[0] = forwards && has_ray > 0.999 ? 1.0 : 0.0;
    path[0] = vec4(at_infinity, shift);
    bend[0] = vec4(0.0);
    mixed_bend[0] = vec2(0.0);
    sides = vec4(dFdx(at_infinity), dFdy(at_infinity));
    samples_per_axis = clamp(ceil(largest_stretch(mat2(sides.xy, sides.zw)) / SPACING_PX), 1.0, most_samples_per_axis);
#ifdef WIDE_TILES  // texture with the bounds of each tile and of two tiles around it, valid for shorter paths
    vec2 middle = (at_infinity + 0.5 * nearest * shift) / (float(TILE) * vec2(size_of(WIDE_TILES)));
    range = length(shift) * nearest <= 4.0 * float(TILE) ? nearest_sampled(WIDE_TILES, middle).xy : vec2(0.0, nearest);
#else
    range = vec2(0.0, nearest);
#endif
    is_direct = length(shift) * nearest <= DIRECT_PX;
    shade();
    colour = vec4(light, alpha);
}
#endif
#endif
