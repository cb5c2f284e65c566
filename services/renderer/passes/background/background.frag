#version 430
layout(early_fragment_tests) in;
// The light map as the rays through the pixels see it: polar, theta down and phi to the right. Nothing where a hemisphere ends.
#include "compositing.glsl"

uniform sampler2D polar;
uniform float span;  // of theta: pi / 2 or pi
uniform float gain;
uniform mat3 ray_from_pixel;
layout(location = 0) out vec4 radiance;

const float TURN = 6.28318530717959;
const float WHOLE_SPHERE = 3.0;  // a span beyond it is pi; any value in pi / 2 to pi does

void main() {
    vec3 ray = ray_from_pixel * vec3(gl_FragCoord.xy, 1.0);
    float theta = atan(length(ray.xy), ray.z);
    if (theta >= span && span < WHOLE_SPHERE) discard;
    radiance = composited(textureLod(polar, vec2(atan(ray.y, ray.x) / TURN, theta / span), 0.0).rgb * gain);
}
