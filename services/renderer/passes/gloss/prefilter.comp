#version 430
// A level of the prefiltered map.
#include "constants.glsl"
#include "normals.glsl"
#include "octahedral_map.glsl"
#include "prefilter.glsl"

layout(local_size_x = PREFILTER_GROUP, local_size_y = PREFILTER_GROUP) in;
layout(rgba32f, binding = 0) writeonly uniform image2D target;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = imageSize(target);
    if (all(lessThan(texel, size))) imageStore(target, texel, vec4(prefiltered_texel(vec2(texel) + 0.5, float(size.x)), 1.0));
}
