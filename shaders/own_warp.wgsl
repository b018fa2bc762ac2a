// Warp of an eye's picture to its panel, for a WebGPU renderer. A `WarpMesh` of wlr_render/warp/warp_mesh.py
// gives vertices, indices and `image_from_ray`; docs/realtime.md, "Your own warp", says how to use it.
//
// Draw the mesh's triangles to a target of an sRGB format, with no culling and no depth test. With three colours draw
// three times, each with its own rays and a write mask of red, green or blue. The picture has an sRGB format too: light
// is filtered linearly, decoded by the sampler and encoded by the target.

struct Warp {
    image_from_ray: array<vec4f, 3>,  // rows: of u depth, of v depth, of depth
    clip_from_panel: vec4f,  // scale, offset of panel_position: (2, -2, -1, 1) puts the panel's top row on top
    inverse_of_0_and_1: vec2f,  // 1/m that the depth buffer's 0 and 1 stand for: 1 / near and 1 / far, or reversed
    nearest: f32,  // 1/m: the largest inverse depth in the picture, or 1 / near
    samples_per_axis: u32,  // WarpMesh.samples_per_axis
    background: vec4f,  // linear light
}

@group(0) @binding(0) var<uniform> warp: Warp;
@group(0) @binding(1) var picture: texture_2d<f32>;  // top row first, as WebGPU draws
@group(0) @binding(2) var between_texels: sampler;  // linear, clamped to the edge
@group(0) @binding(3) var depth: texture_2d<f32>;  // of the same size; bind depth32float or r32float as unfilterable float

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) forwards: vec3f,  // the ray's direction and start, projected, before the division by depth:
    @location(1) start: vec3f,  // both are linear in the ray, so that interpolating them adds no error
    @location(2) known: f32,  // 1 where all three vertices have a ray
}

@vertex
fn vertex(@location(0) panel_position: vec2f, @location(1) ray: vec4f) -> Corner {
    // By bits, because compilers may assume that there is no NaN.
    let missing = any((bitcast<vec4u>(ray) & vec4u(0x7fffffffu)) > vec4u(0x7f800000u));
    let abcd = select(ray, vec4f(0.0), vec4<bool>(missing));
    var corner: Corner;
    for (var i = 0; i < 3; i++) {
        let row = warp.image_from_ray[i];
        corner.forwards[i] = dot(row.xy, abcd.xy) - row.z;
        corner.start[i] = dot(row.xy, abcd.zw) + row.w;
    }
    corner.known = select(1.0, 0.0, missing);
    corner.position = vec4f(panel_position * warp.clip_from_panel.xy + warp.clip_from_panel.zw, 0.0, 1.0);
    return corner;
}

const STEP_PX = 1.0;
const MAX_STEPS = 64.0;
const MAX_REFINEMENTS = 6;
const CONVERGED_PX = 0.01;
const SURFACE_STEP = 0.02;  // texels whose inverse depths differ by a larger share belong to different surfaces
const SPACING_PX = 1.25;  // largest distance of samples in the picture

fn inverse_depth_of_texel(texel: vec2i) -> f32 {
    let last = vec2i(textureDimensions(depth)) - 1;
    let stored = textureLoad(depth, clamp(texel, vec2i(0), last), 0).x;
    let far = select(1.0, 0.0, warp.inverse_of_0_and_1.x < warp.inverse_of_0_and_1.y);
    let inverse = mix(warp.inverse_of_0_and_1.x, warp.inverse_of_0_and_1.y, stored);
    return select(0.0, inverse, stored != far && inverse > 0.0);
}

// Bilinear within a surface (exact for planes), the nearest texel at its edges.
fn inverse_depth_at(pixel: vec2f) -> f32 {
    let base = floor(pixel - 0.5);
    var weight = pixel - 0.5 - base;
    let texel = vec2i(base);
    let a = inverse_depth_of_texel(texel);
    let b = inverse_depth_of_texel(texel + vec2i(1, 0));
    let c = inverse_depth_of_texel(texel + vec2i(0, 1));
    let d = inverse_depth_of_texel(texel + vec2i(1, 1));
    let high = max(max(a, b), max(c, d));
    let low = min(min(a, b), min(c, d));
    weight = select(weight, step(vec2f(0.5), weight), vec2<bool>(high - low > SURFACE_STEP * high));
    return mix(mix(a, b, weight.x), mix(c, d, weight.x), weight.y);
}

// The inverse depth w at which the ray, seen at at_infinity + w shift, meets what the picture shows. The ray is followed
// from near to far; where it meets nothing, because an edge hides it, the farther side of that edge is shown.
//
// Without late motion and near objects, `shift` is short. Then two reads are enough, and this can stand in for the loop:
//     return inverse_depth_at(at_infinity + inverse_depth_at(at_infinity) * shift);
fn meet(at_infinity: vec2f, shift: vec2f) -> f32 {
    let px_per_inverse_depth = length(shift);
    let steps = clamp(ceil(px_per_inverse_depth * warp.nearest / STEP_PX), 1.0, MAX_STEPS);
    let stride = warp.nearest / steps;
    var seen_near = inverse_depth_of_texel(vec2i(floor(at_infinity + warp.nearest * shift)));
    var in_front = true;
    var last_crossing = warp.nearest;
    for (var i = 1.0; i <= steps; i += 1.0) {
        let far_end = warp.nearest - i * stride;
        let middle = far_end + 0.5 * stride;
        let seen_far = inverse_depth_at(at_infinity + far_end * shift);
        let nearer = max(seen_near, seen_far);
        let from_front = nearer >= far_end || i == steps;
        let from_behind = abs(seen_far - middle) <= 0.51 * stride;
        if (select(from_behind, from_front, in_front)) {
            var query = select(min(seen_near, seen_far), nearer, abs(nearer - middle) <= 1.5 * stride);
            last_crossing = nearer;
            for (var k = 0; k < MAX_REFINEMENTS; k++) {
                if (steps > 1.0 && abs(query - middle) > 1.5 * stride) {
                    break;
                }
                let seen = inverse_depth_at(at_infinity + query * shift);
                if (abs(seen - query) * px_per_inverse_depth < CONVERGED_PX) {
                    return seen;
                }
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
fn place_on_surface(pixel: vec2f, surface: f32, half_px: f32) -> vec2f {
    let base = floor(pixel - 0.5);
    let weight = pixel - 0.5 - base;
    let texel = vec2i(base);
    let texels = vec4f(inverse_depth_of_texel(texel), inverse_depth_of_texel(texel + vec2i(1, 0)),
                       inverse_depth_of_texel(texel + vec2i(0, 1)), inverse_depth_of_texel(texel + vec2i(1, 1)));
    let step = max(SURFACE_STEP * max(texels, vec4f(surface)), vec4f(half_px));
    let belongs = select(vec4f(0.0), vec4f(1.0), abs(texels - surface) <= step);
    let share = belongs * vec4f(1.0 - weight.x, weight.x, 1.0 - weight.x, weight.x) * vec4f(1.0 - weight.yy, weight.yy);
    let largest = max(max(share.x, share.y), max(share.z, share.w));
    let own = vec2f(select(0.0, 1.0, max(share.y, share.w) == largest), select(0.0, 1.0, max(share.z, share.w) == largest));
    let row = mix(belongs.x * belongs.y, belongs.z * belongs.w, own.y);
    let column = mix(belongs.x * belongs.z, belongs.y * belongs.w, own.x);
    let all_belong = belongs.x * belongs.y * belongs.z * belongs.w == 1.0;
    let in_column = select(own, vec2f(own.x, weight.y), column == 1.0);
    let moved = select(in_column, vec2f(weight.x, own.y), row == 1.0);
    return base + 0.5 + select(moved, weight, all_belong || largest == 0.0);
}

// The position in the picture, in pixels, v down from the top row; z is 1 where the picture shows something.
fn source_of(corner: Corner) -> vec3f {
    let size_px = vec2f(textureDimensions(picture));
    let has_ray = corner.known > 0.999 && corner.forwards.z > 0.0;
    let at_infinity = corner.forwards.xy / select(1.0, corner.forwards.z, has_ray);
    let shift = corner.start.xy - corner.start.z * at_infinity;
    if (!has_ray) {
        return vec3f(0.0);
    }
    let pixel = at_infinity + meet(at_infinity, shift) * shift;
    let inside = all(pixel >= vec2f(0.0)) && all(pixel <= size_px);
    return vec3f(pixel, select(0.0, 1.0, inside));
}

// The largest factor by which a step on the display is stretched in the picture: the larger singular value.
fn largest_stretch(across: vec2f, down: vec2f) -> f32 {
    let both = 0.5 * (dot(across, across) + dot(down, down));
    let area = across.x * down.y - across.y * down.x;
    return sqrt(both + sqrt(max(both * both - area * area, 0.0)));
}

@fragment
fn fragment(corner: Corner) -> @location(0) vec4f {
    let at_infinity = corner.forwards.xy / corner.forwards.z;
    let across = dpdx(at_infinity);  // the sides of a display pixel in the picture
    let down = dpdy(at_infinity);
    let source = source_of(corner);
    if (source.z == 0.0) {
        return warp.background;
    }
    let per_px = 1.0 / vec2f(textureDimensions(picture));
    let surface = inverse_depth_of_texel(vec2i(floor(source.xy)));
    let half_px = 0.5 / max(length(corner.start.xy - corner.start.z * at_infinity), 1e-12);  // as an inverse depth
    let n = clamp(u32(ceil(largest_stretch(across, down) / SPACING_PX)), 1u, warp.samples_per_axis);
    var sum = vec4f(0.0);
    for (var i = 0u; i < n * n; i++) {
        let place = (vec2f(f32(i % n), f32(i / n)) + 0.5) / f32(n) - 0.5;
        let pixel = place_on_surface(source.xy + place.x * across + place.y * down, surface, half_px);
        sum += textureSampleLevel(picture, between_texels, pixel * per_px, 0.0);
    }
    return sum / f32(n * n);
}
