#version 430
uniform mat4 clip_from_world;
uniform mat4 world_from_rest;  // 1 but for a mesh that moved
uniform mat3 normal_from_rest;
in vec3 position;
in vec3 normal;
in vec2 uv;
in vec4 vertex_colour;
#if PLACED
in vec2 second_uv;
out vec2 surface_second_uv;
#endif
#if CUT
out vec3 rest_position;
out float surface_alpha;
#endif
out vec3 surface_position;
out vec3 surface_normal;
out vec2 surface_uv;
out vec3 surface_colour;

void main() {
    vec4 place = world_from_rest * vec4(position, 1.0);
    surface_position = place.xyz;
    surface_normal = normal_from_rest * normal;
    surface_uv = uv;
    surface_colour = vertex_colour.rgb;
#if PLACED
    surface_second_uv = second_uv;
#endif
#if CUT
    rest_position = position;
    surface_alpha = vertex_colour.a;
#endif
    gl_Position = clip_from_world * place;
}
