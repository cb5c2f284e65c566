#version 430
uniform mat4 clip_from_world;
in vec3 position;
in vec3 normal;
out vec3 surface_position;
out vec3 surface_normal;

void main() {
    surface_position = position;
    surface_normal = normal;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
