#version 430
// The world ray of each display pixel under a planar bundle; rendering/gl_solve.py has the words, and generates
// display_hold, display, display_contains, deviation and deviation_contains.

uniform sampler2D last_view_tangents;
uniform bool has_last;
uniform vec2 panel_px_per_pixel;
uniform vec3 viewpoint;
uniform float behind_display_plane;  // metres from the base plane back to the viewpoint, along +z
uniform float behind_see_through_plane;
uniform bool viewpoint_inside;
uniform float tolerance;  // of the residual, metres
uniform mat3 camera_from_device;

layout(location = 0) out vec4 bend;  // a, b, c, d
layout(location = 1) out vec2 view_tangents;
layout(location = 2) out uvec2 status_and_iterations;

const float NOWHERE = uintBitsToFloat(0x7fc00000u);
const float INFINITE = uintBitsToFloat(0x7f800000u);

struct Root {
    vec2 point;
    vec2 tangents;
    bool solved;
    int iterations;  // evaluations after the first
};

// Newton on p~ - viewpoint_xy - dz t(pixel, p~); steps that do not shrink the residual are halved. A start from
// `tangents` of another frame that leads nowhere is followed by the cold one.
Root solve(vec2 tangents, bool cold)
{
    vec2 base, step, residual;
    mat2 slope;
    float size, size_at_base;
    Root root = Root(vec2(0.0), tangents, false, 0);
    int limit = cold ? MAX_ITERATIONS : 2 * MAX_ITERATIONS;
    do {
        if (root.iterations % MAX_ITERATIONS == 0) {
            base = viewpoint.xy + (root.iterations == 0 ? behind_display_plane * tangents : vec2(0.0));
            step = vec2(0.0);
            size_at_base = INFINITE;
        }
        root.point = base - step;
        root.tangents = display(root.point, slope);
        residual = root.point - viewpoint.xy - behind_display_plane * root.tangents;
        size = length(residual);
        root.solved = size <= tolerance;
        bool shrunk = size < size_at_base;
        base = shrunk ? root.point : base;
        step = shrunk ? inverse(mat2(1.0) - behind_display_plane * slope) * residual : 0.5 * step;
        size_at_base = shrunk ? size : size_at_base;
    } while (!root.solved && ++root.iterations < limit);
    return root;
}

void main()
{
    vec2 pixel = gl_FragCoord.xy * panel_px_per_pixel;
    display_hold(pixel);
    vec2 last = texelFetch(last_view_tangents, ivec2(gl_FragCoord.xy), 0).xy;
    bool cold = !has_last || any(isnan(last));
    Root root = solve(cold ? vec2(0.0) : last, cold);

    vec4 inputs = vec4(viewpoint.xy + behind_see_through_plane * root.tangents, root.tangents);
    vec4 bent = deviation(inputs);
    // Where the ray, taken straight back, passes the viewpoint's z: B - dz A beside the viewpoint.
    vec3 offset = camera_from_device * vec3(bent.zw - behind_see_through_plane * bent.xy, 0.0);
    vec3 direction = camera_from_device * vec3(root.tangents + bent.xy, -1.0);
    vec2 tangents = direction.xy / -direction.z;
    vec4 ray = vec4(tangents, offset.xy + offset.z * tangents);

    bool solved = root.solved && !any(isnan(ray)) && !any(isinf(ray));
    bool forwards = direction.z < 0.0;
    bool inside = viewpoint_inside && display_contains(vec4(pixel, root.point)) && deviation_contains(inputs);
    int status = !solved ? NOT_CONVERGED : !forwards ? MISS : inside ? OK : OUTSIDE_FIT;
    bend = solved && forwards ? ray : vec4(NOWHERE);
    view_tangents = solved ? root.tangents : vec2(NOWHERE);
    status_and_iterations = uvec2(status, root.iterations);
}
