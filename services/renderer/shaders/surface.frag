#version 430
// What each pixel sees, so that the lights are summed once for each visible surface.
#include "normals.glsl"
#include "seen.glsl"

uniform float kind;  // of material: 0 Lambert, 1 with Phong, 2 GGX, 3 a catcher of shadows
uniform vec3 colour;  // diffuse; base colour
uniform vec3 shine;  // specular; metallic, 0, 0
uniform float shape;  // exponent; roughness
uniform sampler2D colour_image;
uniform sampler2D shape_image;  // metallic, roughness
uniform sampler2D normal_image;  // in the frame of the texture coordinates, 0 .. 1 for -1 .. 1
uniform bool bumpy;
in vec3 surface_position;
in vec3 surface_normal;
in vec2 surface_uv;
in vec3 surface_colour;
layout(location = 0) out float out_depth;
layout(location = 1) out vec4 out_normals;
layout(location = 2) out vec4 out_diffuse;  // w: kind
layout(location = 3) out vec4 out_specular;  // at normal incidence; w: exponent, or roughness squared

const float SMOOTHEST = 0.05;  // roughness; a directional light in a smoother surface is a highlight smaller than a pixel

// The normal that the image says. Its frame follows from how position and texture coordinates change over the picture (Schueler 2013),
// whichever way round the picture shows them.
vec3 bumped(vec3 normal) {
    vec3 across = dFdx(surface_position), down = dFdy(surface_position);
    vec2 uv_across = dFdx(surface_uv), uv_down = dFdy(surface_uv);
    vec3 bump = 2.0 * texture(normal_image, surface_uv).xyz - 1.0;
    vec3 a = cross(down, normal), b = cross(normal, across);
    vec3 right = a * uv_across.x + b * uv_down.x, up = a * uv_across.y + b * uv_down.y;
    float size = sqrt(max(dot(right, right), dot(up, up)));
    if (size == 0.0) return normal;  // no texture coordinates
    return normalize((right * bump.x + up * bump.y) * (dot(across, a) < 0.0 ? -1.0 / size : 1.0 / size) + normal * bump.z);
}

void main() {
    vec3 flat_normal = normalize(cross(dFdx(surface_position), dFdy(surface_position)));
    if (dot(flat_normal, eye - surface_position) < 0.0) flat_normal = -flat_normal;
    vec3 smooth_normal = normalize(surface_normal);
    bool behind = dot(smooth_normal, flat_normal) < 0.0;
    if (bumpy) smooth_normal = bumped(smooth_normal);
    if (behind) smooth_normal = -smooth_normal;
    vec3 ray = seen_ray();
    out_depth = dot(surface_position - eye, ray) / dot(ray, ray);
    vec4 octahedra = vec4(octahedron_from_direction(smooth_normal), octahedron_from_direction(flat_normal));
    out_normals = (octahedra * CODES + (CODES + 1.0)) / (2.0 * CODES + 1.0);
    vec3 own = colour * surface_colour * texture(colour_image, surface_uv).rgb;
    if (kind != 2.0) {
        out_diffuse = vec4(own, kind);
        out_specular = vec4(shine, min(shape, 65504.0));  // the largest half float: a narrower lobe is less than a pixel
    } else {  // glTF 2.0, appendix B.2
        vec2 metal_rough = vec2(shine.x, shape) * texture(shape_image, surface_uv).rg;
        float rough = max(metal_rough.y, SMOOTHEST);
        out_diffuse = vec4(own * (1.0 - metal_rough.x), kind);
        out_specular = vec4(mix(vec3(0.04), own, metal_rough.x), rough * rough);
    }
}
