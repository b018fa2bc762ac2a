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
