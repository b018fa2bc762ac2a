#version 430
// The world ray of each point of a grid on the panel under a planar bundle; rendering/gl_ray_maps.py has the words, and generates
// display_hold, display, display_contains, deviation and deviation_contains.

uniform sampler2D last_view_tangents;
uniform sampler2D last_slopes;
uniform bool has_last;
uniform vec3 moved;  // since the last frame: the viewpoint's xy, behind_display_plane
uniform vec2 first_px;  // panel position of the first point
uniform vec2 step_px;
uniform vec3 viewpoint;
uniform float behind_display_plane;  // metres from the base plane back to the viewpoint, along +z
uniform float behind_see_through_plane;
uniform bool viewpoint_inside;
uniform mat3 camera_from_device;

layout(location = 0) out vec4 slope_offset;  // a, b, c, d
layout(location = 1) out vec2 view_tangents;
layout(location = 2) out uvec2 status_and_iterations;
layout(location = 3) out vec4 slopes;  // of view_tangents by the viewpoint's xy, columns

const float NOWHERE = uintBitsToFloat(0x7fc00000u);
const float INFINITE = uintBitsToFloat(0x7f800000u);

struct Root {
    vec2 point;
    vec2 tangents;
    mat2 slope;  // of tangents by the point
    bool solved;
    int iterations;  // evaluations of the polynomial
};

// Newton on p~ - viewpoint_xy - dz t(pixel, p~); steps that do not shrink the residual are halved. The last step is
// short enough for t to follow its slope, so that it costs no evaluation. A start from `tangents` of another frame that
// leads nowhere is followed by the cold one.
//
// The loop tests at its head: left from within or at its end, llvmpipe would let a pixel go on with some values of the
// turn in which it left and others of the turn in which the last of its neighbours did.
Root solve(vec2 tangents, bool cold)
{
    vec2 base, advance;
    float size_at_base;
    Root root = Root(vec2(0.0), tangents, mat2(0.0), false, 0);
    int limit = cold ? MAX_ITERATIONS : 2 * MAX_ITERATIONS;
    while (!root.solved && root.iterations < limit) {
        if (root.iterations % MAX_ITERATIONS == 0) {
            base = viewpoint.xy + (root.iterations == 0 ? behind_display_plane * tangents : vec2(0.0));
            advance = vec2(0.0);
            size_at_base = INFINITE;
        }
        vec2 point = base - advance;
        vec2 tangents_at_point = display(point, root.slope);
        vec2 residual = point - viewpoint.xy - behind_display_plane * tangents_at_point;
        float size = length(residual);
        bool shrunk = size < size_at_base;
        base = shrunk ? point : base;
        advance = shrunk ? inverse(mat2(1.0) - behind_display_plane * root.slope) * residual : 0.5 * advance;
        size_at_base = shrunk ? size : size_at_base;
        root.solved = shrunk && length(advance) <= LAST_STEP_M;
        root.point = point - advance;
        root.tangents = tangents_at_point - root.slope * advance;
        ++root.iterations;
    }
    return root;
}

void main()
{
    vec2 pixel = first_px + step_px * (gl_FragCoord.xy - 0.5);
    display_hold(pixel);
    vec2 place = gl_FragCoord.xy / vec2(textureSize(last_view_tangents, 0));
    vec2 last = texture(last_view_tangents, place).xy;
    vec4 slope = texture(last_slopes, place);
    vec2 start = last + mat2(slope.xy, slope.zw) * (moved.xy + moved.z * last);
    bool cold = !has_last || any(isnan(start));
    Root root = solve(cold ? vec2(0.0) : start, cold);

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
    slope_offset = solved && forwards ? ray : vec4(NOWHERE);
    view_tangents = solved ? root.tangents : vec2(NOWHERE);
    status_and_iterations = uvec2(status, root.iterations);
    mat2 by_viewpoint = inverse(mat2(1.0) - behind_display_plane * root.slope) * root.slope;
    slopes = vec4(by_viewpoint[0], by_viewpoint[1]);
}
