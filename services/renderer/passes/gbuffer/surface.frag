#version 430
// What each pixel sees, so that the lights are summed once for each visible surface. MODEL 0: what `kind` says, 1: glTF's specular and
// glossiness, 2: no light changes it. IMAGES: there are any; PLACED: they lie each in its own way; BUMPY: one is of normals. CUT: there are
// holes. EMISSION: something in the scene emits.
#include "normals.glsl"
#include "gbuffer.glsl"

uniform float kind;  // of material: 0 Lambert, 1 with Phong, 2 GGX, 3 a catcher of shadows
uniform vec3 colour;  // diffuse; base colour
uniform vec3 shine;  // specular; metallic, 0, 0
uniform float shape;  // exponent; roughness; glossiness
uniform float reflectance;  // of what is no metal
uniform sampler2D colour_image;
uniform sampler2D shape_image;  // metallic, roughness; specular, glossiness
uniform sampler2D normal_image;  // in the frame of the texture coordinates, 0 .. 1 for -1 .. 1
in vec3 surface_position;
in vec3 surface_normal;
in vec2 surface_uv;
in vec3 surface_colour;
layout(location = 0) out float out_depth;
layout(location = 1) out vec4 out_normals;
layout(location = 2) out vec4 out_diffuse;  // w: kind
layout(location = 3) out vec4 out_specular;  // at normal incidence; w: exponent, or roughness squared
#if EMISSION
uniform vec3 glow;
uniform sampler2D glow_image;
layout(location = 4) out vec4 out_emission;  // radiance
#endif
#if PLACED
uniform vec4 across[4], along[4];  // weights of both sets of texture coordinates in each image's own
uniform vec2 shift[4];
in vec2 surface_second_uv;
vec2 lies(int image) {
    vec4 uv = vec4(surface_uv, surface_second_uv);
    return vec2(dot(across[image], uv), dot(along[image], uv)) + shift[image];
}
#define LIES(image) lies(image)
#else
#define LIES(image) surface_uv
#endif
#if IMAGES
#define SEEN(sampler, image) texture(sampler, LIES(image))
#else
#define SEEN(sampler, image) vec4(1.0)
#endif
#if CUT
#include "alpha_test.glsl"
uniform float opacity, cutoff;
uniform uint sampled;
in vec3 rest_position;
in float surface_alpha;
#endif

const float SMOOTHEST = 0.05;  // roughness; a directional light in a smoother surface is a highlight smaller than a pixel

#if BUMPY
// The normal that the image says. Its frame follows from how position and texture coordinates change over the picture (Schueler 2013),
// whichever way round the picture shows them.
vec3 bumped(vec3 normal) {
    vec3 across = dFdx(surface_position), down = dFdy(surface_position);
    vec2 uv = LIES(2), uv_across = dFdx(uv), uv_down = dFdy(uv);
    vec3 bump = 2.0 * texture(normal_image, uv).xyz - 1.0;
    vec3 a = cross(down, normal), b = cross(normal, across);
    vec3 right = a * uv_across.x + b * uv_down.x, up = a * uv_across.y + b * uv_down.y;
    float size = sqrt(max(dot(right, right), dot(up, up)));
    if (size == 0.0) return normal;  // no texture coordinates
    return normalize((right * bump.x + up * bump.y) * (dot(across, a) < 0.0 ? -1.0 / size : 1.0 / size) + normal * bump.z);
}
#endif

void main() {
    vec3 flat_normal = normalize(cross(dFdx(surface_position), dFdy(surface_position)));
    if (dot(flat_normal, eye - surface_position) < 0.0) flat_normal = -flat_normal;
    vec3 smooth_normal = normalize(surface_normal);
    bool behind = dot(smooth_normal, flat_normal) < 0.0;
#if BUMPY
    smooth_normal = bumped(smooth_normal);
#endif
    if (behind) smooth_normal = -smooth_normal;
    vec3 ray = seen_ray();
    out_depth = dot(surface_position - eye, ray) / dot(ray, ray);
    vec4 octahedra = vec4(octahedron_from_direction(smooth_normal), octahedron_from_direction(flat_normal));
    out_normals = (octahedra * CODES + (CODES + 1.0)) / (2.0 * CODES + 1.0);
    vec4 image = SEEN(colour_image, 0);
    vec3 own = colour * surface_colour * image.rgb;
#if EMISSION
    out_emission = vec4(MODEL == 2 ? own : glow * SEEN(glow_image, 3).rgb, 0.0);
#endif
#if MODEL == 1
    vec4 gloss = SEEN(shape_image, 1);
    vec3 specular = shine * gloss.rgb;
    float rough = max(1.0 - shape * gloss.a, SMOOTHEST);
    out_diffuse = vec4(own * (1.0 - max(specular.r, max(specular.g, specular.b))), kind);
    out_specular = vec4(specular, rough * rough);
#elif MODEL == 2
    out_diffuse = out_specular = vec4(0.0);
#else
    if (kind != 2.0) {
        out_diffuse = vec4(own, kind);
        out_specular = vec4(shine, min(shape, 65504.0));  // the largest half float: a narrower lobe is less than a pixel
    } else {  // glTF 2.0, appendix B.2
        vec2 metal_rough = vec2(shine.x, shape) * SEEN(shape_image, 1).rg;
        float rough = max(metal_rough.y, SMOOTHEST);
        out_diffuse = vec4(own * (1.0 - metal_rough.x), kind);
        out_specular = vec4(mix(vec3(reflectance), own, metal_rough.x), rough * rough);
    }
#endif
#if CUT
    float share = opacity * surface_alpha, near = IMAGES == 1 ? textureLod(colour_image, LIES(0), 0.0).a : 1.0;
    if (cut_away(share * near, share * image.a, cutoff, rest_position, sampled)) discard;
#endif
}
