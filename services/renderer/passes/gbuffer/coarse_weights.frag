#version 430
// How much of what the four coarse pixels about a pixel have it takes, by how far they lie on its own surface; of a thin thing that none of them
// sees, as if it lay on theirs. Zeros where there is no surface.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"

uniform sampler2D coarse_depth;
uniform sampler2D coarse_normals;
layout(location = 0) out vec4 weights;

const float SAME_NORMAL = 8.0;  // exponent of the cosine between two normals
const float SAME_PLANE = 0.006;  // of the distance to the eye: so far off a pixel's plane a neighbour counts by 1 / e
const float LEAST = 1e-3;  // of all weights, below which no neighbour is of the same surface; any value in 1e-6 to 1e-2 does

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = surface_position(pixel);
    weights = vec4(0.0);
    if (position.w == 0.0) return;
    vec3 normal = surface_smooth_normal(pixel), flat_normal = surface_flat_normal(pixel);
    float reach = SAME_PLANE * distance(position.xyz, eye);
    ivec2 first = pixel / STEP, last = textureSize(coarse_depth, 0) - 1;
    vec2 part = vec2(pixel - STEP * first) / float(STEP);
    vec4 any = vec4(0.0);
    for (int k = 0; k < 4; ++k) {
        ivec2 texel = min(first + ivec2(k & 1, k >> 1), last);
        float depth = texelFetch(coarse_depth, texel, 0).r;
        if (depth <= 0.0) continue;
        float weight = ((k & 1) == 0 ? 1.0 - part.x : part.x) * ((k >> 1) == 0 ? 1.0 - part.y : part.y);
        any[k] = weight + LEAST;
        vec3 there = eye + depth * (ray_from_pixel * vec3(vec2(STEP * texel) + 0.5, 1.0));
        vec3 own = direction_from_octahedron(octahedron_from_code(texelFetch(coarse_normals, texel, 0).xy));
        float off = dot(flat_normal, there - position.xyz) / reach;
        weights[k] = weight * pow(max(dot(normal, own), 0.0), SAME_NORMAL) * exp(-off * off);
    }
    float total = dot(weights, vec4(1.0));
    weights = total > LEAST ? weights / total : any / max(dot(any, vec4(1.0)), 1e-9);
}
