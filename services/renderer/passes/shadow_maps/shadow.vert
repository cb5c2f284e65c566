#version 430
// One instance draws the casters into one light's map in the atlas. ALPHA_TEST: with what shadow_alpha_test.frag asks. RECEIVER_PLANE: the
// plane that everything stands on, which reaches beyond the map and casts for lights from below.
#include "constants.glsl"
#include "light_frame.glsl"
#include "lights.glsl"
#if ALPHA_TEST
#include "alpha_tested_vertex.glsl"
#include "alpha_tested_outputs.glsl"
#else
#include "caster_vertex.glsl"
#endif

// Of the bias: how far a receiver plane lies nearer to the light, so that no light comes through at the foot of what stands on it. Below
// 1, or the plane would shadow itself; any value in 0.5 to 0.95 does.
const float RECEIVER_PLANE_LIFT = 0.9;

uniform int first_light;
uniform mat4 world_from_rest;
#if RECEIVER_PLANE
#ifdef GL_ES  // which neither clips there nor clamps depths: shadow.frag does
out vec4 inside;
out float plane_depth;
#else
out float gl_ClipDistance[4];  // what reaches beyond the map ends at its empty rim
#endif
#endif

void main() {
    int i = first_light + gl_InstanceID;
    vec4 p = world_from_rest * vec4(position, 1.0);
    vec2 own = vec2(dot(lights[i].column, p), dot(lights[i].row, p));
    vec2 texel = lights[i].corner + own;
    float depth = dot(lights[i].depth, p);
#if RECEIVER_PLANE
    depth -= RECEIVER_PLANE_LIFT * lights[i].bias;
    vec4 within = vec4(own - vec2(GUTTER), vec2(lights[i].resolution - float(GUTTER)) - own);
#ifdef GL_ES
    inside = within;
    plane_depth = depth;
    depth = 0.5;
#else
    for (int k = 0; k < 4; ++k) gl_ClipDistance[k] = within[k];
#endif
#endif
    gl_Position = vec4(2.0 * texel * atlas_texel - 1.0, 2.0 * depth - 1.0, 1.0);
#if ALPHA_TEST
    pass_alpha(uint(lights[i].map));
#endif
}
