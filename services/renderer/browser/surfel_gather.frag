#version 430
// Irradiance of each surfel: what those send that its rays have found so far. w: 1, or 0 where it lies within a closed mesh.
#include "surfel_laws.glsl"

uniform highp sampler2D links;
uniform highp sampler2D sent;  // radiance of the surfels
uniform int ray_count;  // that are known
layout(location = 0) out vec4 irradiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec3 sum = vec3(0.0);
    float inside = 0.0;
    for (int k = 0; k < ray_count; ++k) {
        float link = texelFetch(links, pixel + ivec2(SURFEL_SIDE * k, 0), 0).r;
        if (link >= 0.0) sum += texelFetch(sent, ivec2(int(link) % SURFEL_SIDE, int(link) / SURFEL_SIDE), 0).rgb;
        inside += link == SEES_INSIDE ? 1.0 : 0.0;
    }
    float outside = float(ray_count) - inside;
    irradiance = inside > MOST_INSIDE * float(ray_count) ? vec4(0.0) : vec4(3.14159265 / max(outside, 1.0) * sum, 1.0);
}
