#version 430
// The scene's meshes as the camera sees them. UV_TRANSFORM: textures lie each in its own way; ALPHA_TEST: some of the surface is not there.
#include "scene_vertex.glsl"

uniform mat4 clip_from_world;
uniform mat4 world_from_rest;  // identity but for a mesh that moved
uniform mat3 normal_from_rest;
#if UV_TRANSFORM
out vec2 surface_second_uv;
#endif
#if ALPHA_TEST
out vec3 rest_position;
out float surface_alpha;
#endif
#ifdef SURFELS  // of browsers, which keep at places what surfaces send to each other: what the surface receives on its front and on its back
in vec4 surfels;
in vec4 surfel_weights;
uniform highp sampler2D surfel_irradiance;  // w: 0 where it is not known
uniform int back;  // how much more the surfel on the back is than that on the front
out vec4 front_received;
out vec4 back_received;

vec4 received_of(vec4 numbers) {
    vec4 sum = vec4(0.0);
    for (int k = 0; k < 4; ++k) {
        int surfel = int(numbers[k] + 0.5), side = textureSize(surfel_irradiance, 0).x;
        sum += surfel_weights[k] * texelFetch(surfel_irradiance, ivec2(surfel % side, surfel / side), 0);
    }
    return sum;
}
#endif
out vec3 world_position;
out vec3 surface_normal;
out vec2 surface_uv;
out vec3 surface_colour;

void main() {
    vec4 place = world_from_rest * vec4(position, 1.0);
    world_position = place.xyz;
    surface_normal = normal_from_rest * normal;
    surface_uv = uv;
#ifdef SURFELS
    front_received = received_of(surfels);
    back_received = back > 0 ? received_of(surfels + float(back)) : vec4(0.0);
#endif
    surface_colour = vertex_colour.rgb;
#if UV_TRANSFORM
    surface_second_uv = second_uv;
#endif
#if ALPHA_TEST
    rest_position = position;
    surface_alpha = vertex_colour.a;
#endif
    gl_Position = clip_from_world * place;
}
