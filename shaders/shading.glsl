// The shading model of docs/conventions.md, "Colour"; rendering/shading.py is its twin.

// LIGHT_COUNT is set by the loader: software renderers are many times slower when the loop's length is not known.
#if LIGHT_COUNT > 0
uniform vec4 light_vector[LIGHT_COUNT];  // camera frame: (position, 1) or (direction towards the light, 0)
uniform vec3 light_colour[LIGHT_COUNT];
#endif
uniform vec3 ambient;

vec3 irradiance(vec3 point, vec3 normal)
{
    vec3 sum = ambient;
#if LIGHT_COUNT > 0
    for (int i = 0; i < LIGHT_COUNT; ++i) {
        vec3 towards = light_vector[i].xyz - light_vector[i].w * point;
        float squared = dot(towards, towards);
        float falloff = light_vector[i].w > 0.0 ? 1.0 / squared : 1.0;
        sum += light_colour[i] * (falloff * max(0.0, dot(normal, towards) * inversesqrt(squared)));
    }
#endif
    return sum;
}
