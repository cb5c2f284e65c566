#version 430
uniform mat4 clip_from_world;
in vec3 position;
in vec3 normal;
in vec2 uv;
out vec3 surface_position;
out vec3 surface_normal;
out vec2 surface_uv;

void main() {
    surface_position = position;
    surface_normal = normal;
    surface_uv = uv;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
