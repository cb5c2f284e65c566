#version 430
// The light around, as the rays through the pixels see it: a polar map, theta down and phi to the right. Nothing where the map ends.
#include "behind.glsl"

uniform sampler2D polar;
uniform float span;  // of theta
uniform mat3 ray_from_pixel;
layout(location = 0) out vec4 radiance;

const float TURN = 6.28318530717959;

void main() {
    vec3 ray = ray_from_pixel * vec3(gl_FragCoord.xy, 1.0);
    float theta = atan(length(ray.xy), ray.z);
    if (theta >= span && span < 3.0) discard;
    radiance = behind(textureLod(polar, vec2(atan(ray.y, ray.x) / TURN, theta / span), 0.0).rgb);
}
