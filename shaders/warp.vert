#version 430
// One triangle over the whole target, and what all pixels of a warp share.

uniform sampler2D bend;
uniform sampler2D picture;
uniform sampler2D largest_inverse_depth;  // one texel

flat out vec2 per_bend_texel;
flat out vec2 per_texel;
flat out float largest;

void main()
{
    per_bend_texel = 1.0 / vec2(textureSize(bend, 0));
    per_texel = 1.0 / vec2(textureSize(picture, 0));
    largest = texelFetch(largest_inverse_depth, ivec2(0), 0).r;
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
