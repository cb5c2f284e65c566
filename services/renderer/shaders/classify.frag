#version 430
// Writes each pixel's class as a depth: 2 * (light region of its normal) + (1 if its material shines), nothing where there is no surface.
#include "normals.glsl"

uniform sampler2D surface_positions;
uniform sampler2D surface_normals;
uniform sampler2D surface_specular;
uniform samplerCube region_of_normal;
uniform float alpha;
layout(location = 0) out vec4 radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float there = texelFetch(surface_positions, pixel, 0).w;
    vec3 normal = direction_from_octahedron(texelFetch(surface_normals, pixel, 0).xy);
    float glossy = any(greaterThan(texelFetch(surface_specular, pixel, 0).rgb, vec3(0.0))) ? 1.0 : 0.0;
    float region = texture(region_of_normal, normal).r;
    gl_FragDepth = there > 0.0 ? (2.0 * region + glossy + 0.5) / CLASSES : 1.0;
    radiance = vec4(0.0, 0.0, 0.0, there * alpha);
}
