#version 430
// One instance draws the scene into one tile; what reaches beyond the tile is clipped.
#include "shadow_view.glsl"
#include "cube_faces.glsl"
#include "luminaire_maps.glsl"

#if ALPHA_TEST
#include "alpha_tested_vertex.glsl"
#include "alpha_tested_outputs.glsl"
#else
#include "caster_vertex.glsl"
#endif
uniform mat4 local_from_rest;  // of the mesh that is drawn
out float gl_ClipDistance[4];

void main() {
    ShadowView view = views[gl_InstanceID];
    vec3 q = through_face((local_from_rest * vec4(position, 1.0)).xyz - view.origin, view.face);
    vec2 inside = (2.0 * q.xy - (view.low + view.high) * q.z) / (view.high - view.low);
    gl_ClipDistance[0] = q.z - inside.x;
    gl_ClipDistance[1] = q.z + inside.x;
    gl_ClipDistance[2] = q.z - inside.y;
    gl_ClipDistance[3] = q.z + inside.y;
    vec2 corner = map_corner(gl_InstanceID);
    vec2 atlas = (inside + (2.0 * corner + 1.0) * q.z) / map_columns - q.z;
    float depth = (2.0 * (inverse_depths.x * q.z - 1.0) / (inverse_depths.x - inverse_depths.y)) - q.z;  // z (2 d - 1), d = (1/n - 1/z) / (1/n - 1/f)
    gl_Position = vec4(atlas, depth, q.z);
#if ALPHA_TEST
    pass_alpha(uint(gl_InstanceID));
#endif
}
