#version 410
#include "texels.glsl"
// Copy a picture to a part of a target.

uniform sampler2D image;
uniform vec2 first_px;      // first pixel of the part
uniform int turned_height;  // height of the part, for a target whose rows run upwards; 0 for others

layout(location = 0) out vec4 colour;

void main()
{
    ivec2 texel = ivec2(gl_FragCoord.xy - first_px);
    colour = fetched(image, turned_height > 0 ? ivec2(texel.x, turned_height - 1 - texel.y) : texel);
}
