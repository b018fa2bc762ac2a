#version 410
// Fills what no surface has covered.

uniform vec3 background;  // sRGB

layout(location = 0) out vec4 colour;
layout(location = 1) out float inverse_depth;

void main()
{
    colour = vec4(background, 1.0);
    inverse_depth = 0.0;
}
