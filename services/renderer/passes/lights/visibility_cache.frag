#version 430
// Stores, for each light of a row and each pixel with a surface, the fraction of the light that arrives, in the layer of the light's map.

layout(early_fragment_tests) in;
#include "constants.glsl"
#include "light_frame.glsl"
#include "lights.glsl"
#include "visibility.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"

uniform int light_count;
layout(r8) uniform writeonly image2DArray cached_visibility;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = surface_position(pixel);
    vec3 flat_normal = surface_flat_normal(pixel);
    for (int i = 0; i < light_count; ++i) {
        float cosine = dot(flat_normal, lights[i].direction);
        float arriving = cosine > 0.0 ? visibility(i, position, flat_normal, cosine) : 0.0;
        imageStore(cached_visibility, ivec3(pixel, int(lights[i].map)), vec4(arriving));
    }
}
