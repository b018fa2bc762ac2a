// Warp of an eye's picture to its panel, for a renderer of your own in OpenGL 4.2 or Vulkan. A `WarpMesh` of
// wlr_render/warp/warp_mesh.py gives vertices, indices and `image_from_ray`; docs/realtime.md, "Your own warp",
// says how to use it. own_warp.wgsl is the same for WebGPU.
//
// Compile it twice, after "#version 420" (450 for Vulkan) and "#define VERTEX_STAGE" or "#define FRAGMENT_STAGE". Draw
// the mesh's triangles to a target of an sRGB format (OpenGL: GL_FRAMEBUFFER_SRGB enabled), with no culling and no depth
// test. With three colours draw three times, each with its own rays and a write mask of red, green or blue. The picture
// has an sRGB format too: light is filtered linearly, decoded by the sampler and encoded by the target.

layout(std140, binding = 0) uniform Warp {
    vec4 image_from_ray[3];  // rows: of u depth, of v depth, of depth
    vec4 clip_from_panel;  // scale, offset of panel_position: (2, -2, -1, 1) upright in OpenGL, (2, 2, -1, -1) in Vulkan
    vec4 texture_from_pixel;  // scale, offset: (1 / width, 1 / height, 0, 0), or (1 / width, -1 / height, 0, 1) for a
                              // picture with its bottom row first, as OpenGL draws
    vec2 inverse_of_0_and_1;  // 1/m that the depth buffer's 0 and 1 stand for: 1 / near and 1 / far, or reversed
    float nearest;  // 1/m: the largest inverse depth in the picture, or 1 / near
    int samples_per_axis;  // WarpMesh.samples_per_axis
    vec4 background;  // linear light
};

// The ray's direction and start, projected, before the division by depth: both are linear in the ray, so that
// interpolating them adds no error. `known` is 1 where all three vertices have a ray.

#ifdef VERTEX_STAGE
layout(location = 0) in vec2 panel_position;
layout(location = 1) in vec4 ray;
layout(location = 0) out vec3 forwards;
layout(location = 1) out vec3 start;
layout(location = 2) out float known;

void main()
{
    // By bits, because compilers may assume that there is no NaN.
    bool missing = any(greaterThan(floatBitsToUint(ray) & 0x7fffffffu, uvec4(0x7f800000u)));
    vec4 abcd = missing ? vec4(0.0) : ray;
    for (int i = 0; i < 3; ++i) {
        vec4 row = image_from_ray[i];
        forwards[i] = dot(row.xy, abcd.xy) - row.z;
        start[i] = dot(row.xy, abcd.zw) + row.w;
    }
    known = missing ? 0.0 : 1.0;
    gl_Position = vec4(panel_position * clip_from_panel.xy + clip_from_panel.zw, 0.0, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
layout(binding = 1) uniform sampler2D picture;  // linear filter, clamped to the edge
layout(binding = 2) uniform sampler2D depth;  // nearest filter, clamped to the edge; of the same size
layout(location = 0) in vec3 forwards;
layout(location = 1) in vec3 start;
layout(location = 2) in float known;
layout(location = 0) out vec4 colour;

const float STEP_PX = 1.0;
const float MAX_STEPS = 64.0;
const int MAX_REFINEMENTS = 6;
const float CONVERGED_PX = 0.01;
const float SURFACE_STEP = 0.02;  // texels whose inverse depths differ by a larger share belong to different surfaces
const float SPACING_PX = 1.25;  // largest distance of samples in the picture

float inverse_depth_of_texel(vec2 texel)
{
    float stored = textureLod(depth, (texel + 0.5) * texture_from_pixel.xy + texture_from_pixel.zw, 0.0).r;
    float far = inverse_of_0_and_1.x < inverse_of_0_and_1.y ? 0.0 : 1.0;
    float inverse = mix(inverse_of_0_and_1.x, inverse_of_0_and_1.y, stored);
    return stored != far && inverse > 0.0 ? inverse : 0.0;
}

// Bilinear within a surface (exact for planes), the nearest texel at its edges.
float inverse_depth_at(vec2 pixel)
{
    vec2 base = floor(pixel - 0.5);
    vec2 weight = pixel - 0.5 - base;
    float a = inverse_depth_of_texel(base);
    float b = inverse_depth_of_texel(base + vec2(1.0, 0.0));
    float c = inverse_depth_of_texel(base + vec2(0.0, 1.0));
    float d = inverse_depth_of_texel(base + vec2(1.0, 1.0));
    float high = max(max(a, b), max(c, d));
    float low = min(min(a, b), min(c, d));
    weight = high - low > SURFACE_STEP * high ? step(vec2(0.5), weight) : weight;
    return mix(mix(a, b, weight.x), mix(c, d, weight.x), weight.y);
}

// The inverse depth w at which the ray, seen at at_infinity + w shift, meets what the picture shows. The ray is followed
// from near to far; where it meets nothing, because an edge hides it, the farther side of that edge is shown.
//
// Without late motion and near objects, `shift` is short. Then two reads are enough, and this can stand in for the loop:
//     return inverse_depth_at(at_infinity + inverse_depth_at(at_infinity) * shift);
float meet(vec2 at_infinity, vec2 shift)
{
    float px_per_inverse_depth = length(shift);
    float steps = clamp(ceil(px_per_inverse_depth * nearest / STEP_PX), 1.0, MAX_STEPS);
    float stride = nearest / steps;
    float seen_near = inverse_depth_of_texel(floor(at_infinity + nearest * shift));
    bool in_front = true;
    float last_crossing = nearest;
    for (float i = 1.0; i <= steps; i += 1.0) {
        float far_end = nearest - i * stride;
        float middle = far_end + 0.5 * stride;
        float seen_far = inverse_depth_at(at_infinity + far_end * shift);
        float nearer = max(seen_near, seen_far);
        bool from_front = nearer >= far_end || i == steps;
        bool from_behind = abs(seen_far - middle) <= 0.51 * stride;
        if (in_front ? from_front : from_behind) {
            float query = abs(nearer - middle) <= 1.5 * stride ? nearer : min(seen_near, seen_far);
            last_crossing = nearer;
            for (int k = 0; k < MAX_REFINEMENTS; ++k) {
                if (steps > 1.0 && abs(query - middle) > 1.5 * stride)
                    break;
                float seen = inverse_depth_at(at_infinity + query * shift);
                if (abs(seen - query) * px_per_inverse_depth < CONVERGED_PX)
                    return seen;
                last_crossing = max(seen, query);
                query = seen;
            }
        }
        in_front = seen_far < far_end;
        seen_near = seen_far;
    }
    return last_crossing;
}

// Where to read colour near a pixel: among the four texels around it, those of another surface than the one at this
// inverse depth take no part, unless they lie within half a pixel of it. An edge that has moved leaves no trace.
vec2 place_on_surface(vec2 pixel, float surface, float half_px)
{
    vec2 base = floor(pixel - 0.5);
    vec2 weight = pixel - 0.5 - base;
    vec4 texels = vec4(inverse_depth_of_texel(base), inverse_depth_of_texel(base + vec2(1.0, 0.0)),
                       inverse_depth_of_texel(base + vec2(0.0, 1.0)), inverse_depth_of_texel(base + vec2(1.0, 1.0)));
    vec4 belongs = vec4(lessThanEqual(abs(texels - surface), max(SURFACE_STEP * max(texels, surface), half_px)));
    vec4 share = belongs * vec4(1.0 - weight.x, weight.x, 1.0 - weight.x, weight.x) * vec4(1.0 - weight.yy, weight.yy);
    float largest = max(max(share.x, share.y), max(share.z, share.w));
    vec2 own = vec2(max(share.y, share.w) == largest, max(share.z, share.w) == largest);
    float row = mix(belongs.x * belongs.y, belongs.z * belongs.w, own.y);
    float column = mix(belongs.x * belongs.z, belongs.y * belongs.w, own.x);
    bool all_belong = belongs.x * belongs.y * belongs.z * belongs.w == 1.0;
    vec2 moved = row == 1.0 ? vec2(weight.x, own.y) : column == 1.0 ? vec2(own.x, weight.y) : own;
    return base + 0.5 + (all_belong || largest == 0.0 ? weight : moved);
}

// The position in the picture, in pixels, v down from the top row; z is 1 where the picture shows something.
vec3 source_of_ray()
{
    if (known < 0.999 || forwards.z <= 0.0)
        return vec3(0.0);
    vec2 at_infinity = forwards.xy / forwards.z;
    vec2 shift = start.xy - start.z * at_infinity;
    vec2 pixel = at_infinity + meet(at_infinity, shift) * shift;
    bool inside = all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThanEqual(pixel, vec2(textureSize(picture, 0))));
    return vec3(pixel, inside ? 1.0 : 0.0);
}

// The largest factor by which a step on the display is stretched in the picture: the larger singular value.
float largest_stretch(vec2 across, vec2 down)
{
    float both = 0.5 * (dot(across, across) + dot(down, down));
    float area = across.x * down.y - across.y * down.x;
    return sqrt(both + sqrt(max(both * both - area * area, 0.0)));
}

void main()
{
    vec2 at_infinity = forwards.xy / forwards.z;
    vec2 across = dFdx(at_infinity);  // the sides of a display pixel in the picture
    vec2 down = dFdy(at_infinity);
    vec3 source = source_of_ray();
    colour = background;
    if (source.z == 0.0)
        return;
    float surface = inverse_depth_of_texel(floor(source.xy));
    float half_px = 0.5 / max(length(start.xy - start.z * at_infinity), 1e-12);  // as an inverse depth
    int n = clamp(int(ceil(largest_stretch(across, down) / SPACING_PX)), 1, samples_per_axis);
    vec4 sum = vec4(0.0);
    for (int i = 0; i < n * n; ++i) {
        vec2 place = (vec2(i % n, i / n) + 0.5) / float(n) - 0.5;
        vec2 pixel = place_on_surface(source.xy + place.x * across + place.y * down, surface, half_px);
        sum += textureLod(picture, pixel * texture_from_pixel.xy + texture_from_pixel.zw, 0.0);
    }
    colour = sum / float(n * n);
}
#endif
