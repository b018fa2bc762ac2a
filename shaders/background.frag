#version 430
#include "srgb.glsl"

uniform vec3 background;

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;
layout(location = 2) out vec3 position_in_world;
layout(location = 3) out vec3 normal_in_world;
layout(location = 4) out ivec2 ids;

const float NOWHERE = uintBitsToFloat(0x7fc00000u);

void main()
{
    colour = vec4(srgb_of_linear(background), 1.0);
    inverse_depth = 0.0;
    position_in_world = vec3(NOWHERE);
    normal_in_world = vec3(NOWHERE);
    ids = ivec2(-1);
}
