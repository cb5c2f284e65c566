#version 430
// Writes each pixel's class as a depth: 4 * (light region of its normal) + its kind of material, nothing where there is no surface.
#include "normals.glsl"
#include "gbuffer.glsl"

uniform sampler2D surface_diffuse;
uniform samplerCube region_of_normal;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float there = seen_position().w;
    vec3 normal = direction_from_octahedron(seen_normals().xy);
    float kind = texelFetch(surface_diffuse, pixel, 0).w;
    float region = texture(region_of_normal, normal).r;
    gl_FragDepth = there > 0.0 ? (4.0 * region + kind + 0.5) / CLASSES : 1.0;
}
