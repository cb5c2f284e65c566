#version 430
// Casts no shadow within the light's radius.
in vec3 from_light;
flat in float light_radius;

void main() {
    if (dot(from_light, from_light) < light_radius * light_radius) discard;
}
