#version 430
// Rebuilds, for each entry of all rows and from the light's direction alone, where its shadow map lies: an orthographic view along the light, fitted to the box
// around all that casts its shadow.
#include "light.glsl"

layout(local_size_x = 64) in;

struct Light { vec4 direction; vec4 irradiance; vec4 map_direction; vec4 tile; };  // the map may have been drawn for a direction nearby; w: its number
layout(std430, binding = 1) readonly buffer Given { Light given[]; };
layout(std430, binding = 2) writeonly buffer Made { LightFrame made[]; };

uniform int light_count;
uniform vec3 box_centre;
uniform vec3 box_half;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= uint(light_count)) return;
    vec3 d = given[i].map_direction.xyz;
    float side = given[i].tile.z;

    // Right and up of the view: Duff et al. 2017, Building an Orthonormal Basis, Revisited; the branch is on z < 0.
    float s = d.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + d.z);
    vec3 right = vec3(1.0 + s * d.x * d.x * a, s * d.x * d.y * a, -s * d.x);
    vec3 up = vec3(d.x * d.y * a, s + d.y * d.y * a, -d.y);

    // Half extents of the box in the view; never 0, so that a flat box keeps a map.
    vec3 reach = vec3(dot(abs(right), box_half), dot(abs(up), box_half), dot(abs(d), box_half));
    reach += 1e-4 * dot(box_half, vec3(1.0));
    vec3 scale = vec3(0.5 * side - GUTTER, 0.5 * side - GUTTER, -0.5 * DEEPEST) / reach;
    vec3 middle = vec3(0.5 * side, 0.5 * side, 0.5 * DEEPEST);

    made[i].column = vec4(right * scale.x, middle.x - dot(right, box_centre) * scale.x);
    made[i].row = vec4(up * scale.y, middle.y - dot(up, box_centre) * scale.y);
    made[i].depth = vec4(d * scale.z, middle.z - dot(d, box_centre) * scale.z);
    made[i].direction = vec4(given[i].direction.xyz, -BIAS * scale.z / min(scale.x, scale.y));
    made[i].irradiance = vec4(given[i].irradiance.rgb, given[i].tile.w);
    made[i].tile = vec4(given[i].tile.xyz, 0.0);
    made[i].slope = vec4(-scale.z / (scale.xy * scale.xy), 0.0, 0.0);
}
