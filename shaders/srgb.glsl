// Linear light to sRGB, IEC 61966-2-1.

vec3 srgb_of_linear(vec3 linear)
{
    vec3 c = clamp(linear, 0.0, 1.0);
    vec3 curved = 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055;
    return mix(curved, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}
