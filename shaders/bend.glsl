// World rays as (a, b, c, d): in a camera frame the ray passes through (c, d, 0) with tangents (a, b).

// The same ray in another camera frame, given the three upper rows of the rigid transform to it; NaN if it does not
// lead forwards there. rendering/moved_rays.py has the words.
vec4 seen_from(vec4 ray, vec4 x, vec4 y, vec4 z)
{
    vec2 a = ray.xy, c = ray.zw;
    vec3 direction = vec3(dot(x.xy, a) - x.z, dot(y.xy, a) - y.z, dot(z.xy, a) - z.z);
    vec3 origin = vec3(dot(x.xy, c) + x.w, dot(y.xy, c) + y.w, dot(z.xy, c) + z.w);
    vec2 tangents = direction.xy * (direction.z < 0.0 ? -1.0 / direction.z : uintBitsToFloat(0x7fc00000u));
    return vec4(tangents, origin.xy + origin.z * tangents);
}
