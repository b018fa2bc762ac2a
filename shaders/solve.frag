#version 410
#include "texels.glsl"
// The world ray of each point of a grid on the panel, for planar models; warp/gl_ray_maps.py explains the terms.

uniform sampler2D terms;  // coefficients at each point: rows of t, A and B, two terms per texel, highest powers first
// All other inputs are in one array, which one OpenGL call writes: several eyes share the program.
uniform vec4 inputs_of_eye[11];
vec4 display_box[2] = vec4[](inputs_of_eye[0], inputs_of_eye[1]);    // centre of (u, v, x, y), scaled units per unit
vec4 deviation_box[2] = vec4[](inputs_of_eye[2], inputs_of_eye[3]);  // the same for (x, y, tx, ty)
vec2 first_px = inputs_of_eye[4].xy;  // panel position of the first point
vec2 step_px = inputs_of_eye[4].zw;
vec2 display_plane_slope = inputs_of_eye[5].xy;  // rise of the base plane's z per metre of x and y
vec2 see_through_plane_slope = inputs_of_eye[5].zw;
vec3 viewpoint = inputs_of_eye[6].xyz;
bool viewpoint_inside = inputs_of_eye[6].w == 1.0;
float behind_display_plane = inputs_of_eye[7].x;  // metres from the base plane back to the viewpoint, along +z
float behind_see_through_plane = inputs_of_eye[7].y;
mat3 camera_from_device = transpose(mat3(inputs_of_eye[8].xyz, inputs_of_eye[9].xyz, inputs_of_eye[10].xyz));

layout(location = 0) out vec4 slope_offset;  // a, b, c, d
layout(location = 1) out uint status;

#define NOWHERE uintBitsToFloat(0x7fc00000u)
#define INFINITE uintBitsToFloat(0x7f800000u)

struct Root {
    vec2 point;
    vec2 tangents;
    bool solved;
};

// Depth along -z at which a ray from the viewpoint meets the plane, divided by the viewpoint's height over the plane.
float depth_per_height(vec2 plane_slope, vec2 tangents)
{
    return 1.0 / (1.0 + dot(plane_slope, tangents));
}

// Derivative of the position on the display's base plane by the tangents.
mat2 place_by_tangents(vec2 tangents)
{
    float per_height = depth_per_height(display_plane_slope, tangents);
    return behind_display_plane * per_height * (mat2(1.0) - outerProduct(tangents, per_height * display_plane_slope));
}

vec2 place_on_display_plane(vec2 tangents)
{
    return viewpoint.xy + behind_display_plane * depth_per_height(display_plane_slope, tangents) * tangents;
}

// t, A or B at a scaled position, and its derivatives: terms x^i y^j with i + j <= DEGREE, linear outside the box.
vec2 polynomial(int row_of_point, vec2 scaled, out mat2 slope)
{
    vec2 s = clamp(scaled, -SCALED_LIMIT, SCALED_LIMIT);
    vec2 beyond = scaled - s;
    vec2 value = vec2(0.0);
    slope = mat2(0.0);
    ivec2 point = ivec2(gl_FragCoord.xy);
    ivec2 at = ivec2(point.x * TEXELS, 3 * point.y + row_of_point);
    for (int i = DEGREE; i >= 0; --i) {
        vec2 row = vec2(0.0), by_y = vec2(0.0);
        for (int j = DEGREE - i; j >= 0; j -= 2, ++at.x) {
            vec4 two = fetched(terms, at);
            by_y = by_y * s.y + row;
            row = row * s.y + two.xy;
            by_y = by_y * s.y + row;
            row = row * s.y + two.zw;
        }
        slope[0] = slope[0] * s.x + value;
        slope[1] = slope[1] * s.x + by_y;
        value = value * s.x + row;
    }
    value += slope * beyond;
    return value;
}

// Newton's method on p~ - viewpoint_xy - s t(pixel, p~) from the viewpoint; steps that do not shrink the residual are
// halved. Over the last step t is practically linear, so that no further evaluation is needed.
//
// The loop is tested at its head: with an exit inside or at its end, llvmpipe would leave a pixel with some values from
// its own last iteration and others from the last iteration of its neighbours.
Root solve()
{
    vec2 base = place_on_display_plane(vec2(0.0)), advance = vec2(0.0);
    float size_at_base = INFINITE;
    Root root = Root(vec2(0.0), vec2(0.0), false);
    int iterations = 0;
    while (!root.solved && iterations < MAX_ITERATIONS) {
        mat2 slope;
        vec2 point = base - advance;
        vec2 tangents_at_point = polynomial(0, (point - display_box[0].zw) * display_box[1].zw, slope);
        slope = mat2(slope[0] * display_box[1].z, slope[1] * display_box[1].w);
        vec2 residual = point - place_on_display_plane(tangents_at_point);
        float size = length(residual);
        bool shrunk = size < size_at_base;
        base = shrunk ? point : base;
        mat2 by_point = mat2(1.0) - place_by_tangents(tangents_at_point) * slope;
        advance = shrunk ? inverse(by_point) * residual : 0.5 * advance;
        size_at_base = shrunk ? size : size_at_base;
        root.solved = shrunk && length(advance) <= LAST_STEP_M;
        root.point = point - advance;
        root.tangents = tangents_at_point - slope * advance;
        ++iterations;
    }
    return root;
}

void main()
{
    vec2 pixel = first_px + step_px * (gl_FragCoord.xy - 0.5);
    Root root = solve();

    float depth = behind_see_through_plane * depth_per_height(see_through_plane_slope, root.tangents);
    vec4 inputs = vec4(viewpoint.xy + depth * root.tangents, root.tangents);
    vec4 scaled = (inputs - deviation_box[0]) * deviation_box[1];
    mat2 unused;
    vec4 bent = vec4(polynomial(1, scaled.xy, unused), polynomial(2, scaled.xy, unused));
    // The straight continuation of the ray passes the viewpoint's z at the offset B - s A from the viewpoint.
    vec3 offset = camera_from_device * vec3(bent.zw - depth * bent.xy, 0.0);
    vec3 direction = camera_from_device * vec3(root.tangents + bent.xy, -1.0);
    vec2 tangents = direction.xy / -direction.z;
    vec4 ray = vec4(tangents, offset.xy + offset.z * tangents);

    bool solved = root.solved && !any(isnan(ray)) && !any(isinf(ray));
    bool forwards = direction.z < 0.0;
    vec4 shown = (vec4(pixel, root.point) - display_box[0]) * display_box[1];
    bool inside = viewpoint_inside && all(lessThanEqual(max(abs(shown), abs(scaled)), vec4(SCALED_LIMIT)));
    status = uint(!solved ? NOT_CONVERGED : !forwards ? MISS : inside ? OK : OUTSIDE_FIT);
    slope_offset = solved && forwards ? ray : vec4(NOWHERE);
}
