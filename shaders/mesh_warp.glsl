#version 450
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

#include "texels.glsl"
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

#include "tile_range.glsl"

void main()
{
    range = range_of_tile(depth, gl_FragCoord.xy);
}
#else
#include "conventions.glsl"
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
#include "warp.glsl"

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
