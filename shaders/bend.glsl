// World rays as (a, b, c, d): in a camera frame the ray passes through (c, d, 0) with tangents (a, b).

// The same ray in another camera frame, given the three upper rows of the rigid transform to it; NaN if it does not
// lead forwards there.
vec4 seen_from(vec4 ray, vec4 image_from_field[3])
{
    vec3 direction, origin;
    for (int axis = 0; axis < 3; ++axis) {
        vec4 row = image_from_field[axis];
        direction[axis] = row.x * ray.x + row.y * ray.y - row.z;
        origin[axis] = row.x * ray.z + row.y * ray.w + row.w;
    }
    vec2 tangents = direction.xy / (direction.z < 0.0 ? -direction.z : uintBitsToFloat(0x7fc00000u));
    return vec4(tangents, origin.xy + origin.z * tangents);
}
