#version 430
// Leaves holes in what casts shadows. hole: where in the image, and alpha without it; the rest as alpha_test.glsl has it.
#include "alpha_test.glsl"

uniform sampler2D alpha_image;
uniform float cutoff;
in vec3 hole_here;
in vec3 rest_position;
flat in uint sampled;

void main() {
    float near = textureLod(alpha_image, hole_here.xy, 0.0).r, mean = texture(alpha_image, hole_here.xy).r;
    if (cut_away(hole_here.z * near, hole_here.z * mean, cutoff, rest_position, sampled)) discard;
}
