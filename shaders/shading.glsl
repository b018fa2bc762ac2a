// The shading model of docs/conventions.md, "Colour", in the camera frame; draw/shading.py implements the same model.
//
// The numbers of lights are constants, because software renderers are many times slower with a loop of unknown length.

#if POINT_LIGHTS > 0
uniform vec3 point_light_position[POINT_LIGHTS];
uniform vec3 point_light_colour[POINT_LIGHTS];
#endif
#if DIRECTIONAL_LIGHTS > 0
uniform vec3 towards_directional_light[DIRECTIONAL_LIGHTS];  // unit vectors
uniform vec3 directional_light_colour[DIRECTIONAL_LIGHTS];
#endif
uniform vec3 ambient;

vec3 irradiance(vec3 point, vec3 normal)
{
    vec3 sum = ambient;
#if POINT_LIGHTS > 0
    for (int i = 0; i < POINT_LIGHTS; ++i) {
        vec3 towards = point_light_position[i] - point;
        float per_distance = inversesqrt(dot(towards, towards));
        float falloff = per_distance * per_distance * per_distance;  // the third factor normalises `towards`
        sum += point_light_colour[i] * (falloff * max(0.0, dot(normal, towards)));
    }
#endif
#if DIRECTIONAL_LIGHTS > 0
    for (int i = 0; i < DIRECTIONAL_LIGHTS; ++i) {
        sum += directional_light_colour[i] * max(0.0, dot(normal, towards_directional_light[i]));
    }
#endif
    return sum;
}
