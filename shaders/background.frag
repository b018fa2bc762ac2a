#version 410
// Fills what no surface has covered.

uniform vec3 background;  // sRGB

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;
#if WITH_EXTRA
layout(location = 2) out vec3 position_in_world;
layout(location = 3) out vec3 normal_in_world;
layout(location = 4) out ivec2 ids;

const float NOWHERE = uintBitsToFloat(0x7fc00000u);
#endif

void main()
{
    colour = vec4(background, 1.0);
    inverse_depth = 0.0;
#if WITH_EXTRA
    position_in_world = vec3(NOWHERE);
    normal_in_world = vec3(NOWHERE);
    ids = ivec2(-1);
#endif
}
