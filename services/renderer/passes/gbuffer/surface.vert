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
out vec3 world_position;
out vec3 surface_normal;
out vec2 surface_uv;
out vec3 surface_colour;

void main() {
    vec4 place = world_from_rest * vec4(position, 1.0);
    world_position = place.xyz;
    surface_normal = normal_from_rest * normal;
    surface_uv = uv;
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
