#version 410
#include "conventions.glsl"
#include "srgb.glsl"
#include "texels.glsl"
// The warp as a fragment shader, for cells that are sampled directly or marched.

in vec2 grid_place;
#if UNIFORMITY
in vec2 panel_place;
#endif
in vec4 path[CHANNELS];
in vec4 bend[CHANNELS];
in vec2 mixed_bend[CHANNELS];
flat in float known[CHANNELS];
flat in vec2 cell;
flat in vec2 range;
flat in float samples_per_axis;
flat in float filled;  // 1 if the wider picture around an inset is not drawn here
flat in float nearest_shown;  // inverse depth

uniform bool is_backdrop;  // see warp_cell.glsl
uniform usampler2D front_status;

layout(location = 0) out vec4 colour;
layout(location = 1) out uint worst_status;
layout(location = 2) out vec2 source;

const bool is_direct = MARCH == 0;
bool is_needed;  // false for a backdrop where the picture in front shows something

void sides_of_pixel(const int channel, out vec2 across, out vec2 down)
{
    across = dFdx(path[channel].xy);
    down = dFdy(path[channel].xy);
}

#include "warp.glsl"

void main()
{
    is_needed = MARCH == 0 || !is_backdrop || int(texelFetch(front_status, ivec2(gl_FragCoord), 0).r) == DISOCCLUDED;
    if (!shade())
        discard;
    colour = vec4(light, alpha);
    worst_status = uint(worst);
    source = seen_at;
}
