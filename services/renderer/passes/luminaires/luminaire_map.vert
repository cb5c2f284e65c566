#version 430
// One instance draws the scene into one tile; what reaches beyond the tile is clipped.
#include "luminaire_maps.glsl"

in vec3 position;
#ifdef CUT
in vec3 hole;
out vec3 hole_here;
out vec3 rest_position;
flat out uint sampled;
#endif
uniform mat4 local_from_rest;  // of the mesh that is drawn
out float gl_ClipDistance[4];

void main() {
    vec4 origin = maps[2 * gl_InstanceID];
    vec4 window = maps[2 * gl_InstanceID + 1];
    vec3 q = facing((local_from_rest * vec4(position, 1.0)).xyz - origin.xyz, int(origin.w));
    vec2 inside = (2.0 * q.xy - (window.xy + window.zw) * q.z) / (window.zw - window.xy);
    gl_ClipDistance[0] = q.z - inside.x;
    gl_ClipDistance[1] = q.z + inside.x;
    gl_ClipDistance[2] = q.z - inside.y;
    gl_ClipDistance[3] = q.z + inside.y;
    vec2 corner = map_corner(gl_InstanceID);
    vec2 atlas = (inside + (2.0 * corner + 1.0) * q.z) / map_columns - q.z;
    float depth = (2.0 * (map_range.x * q.z - 1.0) / (map_range.x - map_range.y)) - q.z;  // z (2 d - 1), d = (1/n - 1/z) / (1/n - 1/f)
    gl_Position = vec4(atlas, depth, q.z);
#ifdef CUT
    hole_here = hole;
    rest_position = position;
    sampled = uint(gl_InstanceID);
#endif
}
