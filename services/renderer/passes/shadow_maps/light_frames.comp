#version 430
// Makes the frame of each light: an orthographic view along the direction for which its shadow map was drawn, fitted to the box around all
// that casts shadows.
#include "constants.glsl"
#include "light_entry.glsl"
#include "light_frame.glsl"

layout(local_size_x = WORK_GROUP) in;
layout(std140, binding = 1) readonly buffer Entries { LightEntry entries[]; };
layout(std140, binding = 2) writeonly buffer Frames { LightFrame frames[]; };

uniform int light_count;
uniform vec3 box_centre;
uniform vec3 box_half;

const float FLATTEST_BOX = 1e-4;  // of its extents, added to each, so that a flat box keeps a map; any value in 1e-6 to 1e-3 does

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= uint(light_count)) return;
    vec3 d = entries[i].map_direction;
    float resolution = entries[i].resolution;

    // Right and up of the view: Duff et al. 2017, Building an Orthonormal Basis, Revisited; the branch is on z < 0.
    float s = d.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + d.z);
    vec3 right = vec3(1.0 + s * d.x * d.x * a, s * d.x * d.y * a, -s * d.x);
    vec3 up = vec3(d.x * d.y * a, s + d.y * d.y * a, -d.y);

    // Half extents of the box in the view, and texels and depth a metre.
    vec3 reach = vec3(dot(abs(right), box_half), dot(abs(up), box_half), dot(abs(d), box_half));
    reach += FLATTEST_BOX * dot(box_half, vec3(1.0));
    vec3 scale = vec3(0.5 * resolution - GUTTER, 0.5 * resolution - GUTTER, -0.5 * FARTHEST_DEPTH) / reach;
    vec3 middle = vec3(0.5 * resolution, 0.5 * resolution, 0.5 * FARTHEST_DEPTH);

    frames[i].column = vec4(right * scale.x, middle.x - dot(right, box_centre) * scale.x);
    frames[i].row = vec4(up * scale.y, middle.y - dot(up, box_centre) * scale.y);
    frames[i].depth = vec4(d * scale.z, middle.z - dot(d, box_centre) * scale.z);
    frames[i].direction = entries[i].direction;
    frames[i].bias = -SHADOW_BIAS_TEXELS * scale.z / min(scale.x, scale.y);
    frames[i].irradiance = entries[i].irradiance;
    frames[i].map = entries[i].map;
    frames[i].corner = entries[i].corner;
    frames[i].slope = -scale.z / (scale.xy * scale.xy);
    frames[i].resolution = resolution;
    frames[i].spread = entries[i].spread;
    frames[i].concentration = entries[i].concentration;
    frames[i].lobe_spread = entries[i].lobe_spread;
    frames[i].least_width = entries[i].least_width;
    frames[i].direct = entries[i].direct;
}
