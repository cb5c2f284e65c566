#version 430
// One instance draws the scene into one tile; what reaches beyond the tile is clipped (in browsers, which clip nothing there, by a scissor).
#include "near_shadow_view.glsl"
#include "cube_faces.glsl"

#if ALPHA_TEST
#include "alpha_tested_vertex.glsl"
#include "alpha_tested_outputs.glsl"
#else
#include "caster_vertex.glsl"
#endif
out vec3 from_light;
flat out float light_radius;
layout(std140, binding = 3) readonly buffer DrawnViews { NearShadowView drawn_views[]; };

uniform mat4 world_from_rest;  // of the mesh that is drawn
uniform float map_size;  // texels of a tile's side
uniform vec2 atlas_size;  // texels
uniform int first_view;
#ifndef GL_ES
out float gl_ClipDistance[4];
#endif

void main() {
    NearShadowView view = drawn_views[first_view + gl_InstanceID];
    vec3 away = (world_from_rest * vec4(position, 1.0)).xyz - view.origin;
    vec3 q = through_face(away, view.face);
    vec2 inside = (2.0 * q.xy - (view.low + view.high) * q.z) / (view.high - view.low);
#ifndef GL_ES
    gl_ClipDistance[0] = q.z - inside.x;
    gl_ClipDistance[1] = q.z + inside.x;
    gl_ClipDistance[2] = q.z - inside.y;
    gl_ClipDistance[3] = q.z + inside.y;
#endif
    vec2 atlas = (view.corner * q.z + 0.5 * map_size * (inside + q.z)) / atlas_size * 2.0 - q.z;
    float depth = (2.0 * (view.inverse_depths.x * q.z - 1.0) / (view.inverse_depths.x - view.inverse_depths.y)) - q.z;  // as luminaire_map.vert has it
    gl_Position = vec4(atlas, depth, q.z);
    from_light = away;
    light_radius = view.radius;
#if ALPHA_TEST
    pass_alpha(uint(first_view + gl_InstanceID));
#endif
}
