#version 430
// What each pixel sees, so that the lights are summed once for each visible surface.
#include "normals.glsl"

uniform vec3 eye;
uniform vec3 diffuse;
uniform vec3 specular;
uniform float exponent;
in vec3 surface_position;
in vec3 surface_normal;
layout(location = 0) out vec4 out_position;  // world; w = 1 where there is a surface
layout(location = 1) out vec4 out_normals;  // of shading and of the triangle, both on the viewer's side
layout(location = 2) out vec4 out_diffuse;
layout(location = 3) out vec4 out_specular;  // w: exponent

void main() {
    vec3 flat_normal = normalize(cross(dFdx(surface_position), dFdy(surface_position)));
    if (dot(flat_normal, eye - surface_position) < 0.0) flat_normal = -flat_normal;
    vec3 smooth_normal = normalize(surface_normal);
    if (dot(smooth_normal, flat_normal) < 0.0) smooth_normal = -smooth_normal;
    out_position = vec4(surface_position, 1.0);
    out_normals = vec4(octahedron_from_direction(smooth_normal), octahedron_from_direction(flat_normal));
    out_diffuse = vec4(diffuse, 1.0);
    out_specular = vec4(specular, exponent);
}
