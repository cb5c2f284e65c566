#version 430
// Stores, for each light of a row and each pixel with a surface, which fraction of the light reaches it, in the layer of the light's map.

layout(early_fragment_tests) in;
#include "light.glsl"
#include "lights.glsl"
#include "visibility.glsl"
#include "normals.glsl"
#include "gbuffer.glsl"

uniform int light_count;
layout(r8) uniform writeonly image2DArray cached_visibility;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = seen_position();
    vec3 flat_normal = direction_from_octahedron(seen_normals().zw);
    for (int i = 0; i < light_count; ++i) {
        float seen = visibility(i, position, flat_normal, dot(flat_normal, lights[i].direction.xyz));
        imageStore(cached_visibility, ivec3(pixel, int(lights[i].irradiance.w)), vec4(seen));
    }
}
