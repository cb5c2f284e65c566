#version 430
layout(early_fragment_tests) in;
// Adds what the lobes of glossy surfaces reflect of the prefiltered map, times the fraction of the lobe's light that shadows leave. HAS_PHONG,
// HAS_GGX: whether there are such surfaces.
//
// GGX' distribution of slopes is a mixture of round Gaussians (a multivariate t distribution with two degrees of freedom): a few of them make the
// lobe, core to tails. What such a Gaussian of halfway vectors reflects is (v.h) times as wide across the plane of incidence as in it: a row
// of lookups in the plane, each as wide as the lobe is across, with the BRDF's weight of its halfway vector. The sum is normalised to the
// lobe's albedo.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "octahedral_map.glsl"
#include "lobe_sources.glsl"
#include "lobe_albedo.glsl"
#include "scene_rays.glsl"

// PIXELS: all; those of coarse surfaces, without shadows; or those that take it from coarse ones. gloss_classes.frag tells them apart.

uniform float weight;  // of this pass in the picture: 1 / samples
uniform vec3 scale;  // of the map
uniform float base_variance;  // of level 0 along an axis, rad^2; four times as much in each level after it
uniform sampler2D prefiltered;
#if PIXELS != COARSE
uniform sampler2D lobe_visibility;  // sums over the lights, with shadows and without
uniform bool mirrors;  // whether rays say where the lobe sees the scene: mirrored_scene.a
uniform sampler2D mirrored_scene;
#endif
#if PIXELS == WITH_COARSE
uniform sampler2D coarse_weights;
uniform sampler2D coarse_gloss;
#endif
layout(location = 0) out vec4 radiance;

vec3 looked_up(vec3 direction, float variance) {
    float times = max(variance / base_variance, 1.0);
    float level = floor(0.5 * log2(times));
    float between = (times * exp2(-2.0 * level) - 1.0) / 3.0;  // so that the mixture of two levels has the variance
    return textureLod(prefiltered, prefiltered_uv(direction), level + between).rgb;
}

#if HAS_GGX
// Gaussians with these weights and variances along an axis, over alpha^2, are GGX' 1 / (pi (1 + m^2)^2) within 5.3 % up to m = 16, beyond which
// there is 0.4 % of it: the least squares of their relative error there.
const int PARTS = 5;
const float PART_WEIGHTS[PARTS] = float[](0.3163, 0.4187, 0.1864, 0.0598, 0.0187);
const float PART_VARIANCES[PARTS] = float[](0.232, 0.812, 2.91, 10.776, 49.746);
const float MAX_SIDE = 4.0;  // lookups on either side of the middle one: enough for rows five times as long as wide
const float MAX_REACH = 2.0;  // of a row, in standard deviations
const float MAX_SPACING = 1.6;  // of lookups, in their own standard deviations: beyond it a row is a row of dots

vec3 reflected_ggx(vec3 reflectance, float alpha, vec3 normal, vec3 view) {
    float v = clamp(dot(normal, view), 1e-3, 1.0), a2 = alpha * alpha;
    vec3 outwards = normal * v - view;
    float slant = max(length(outwards), 1e-4);
    outwards /= slant;
    float side = clamp(ceil(MAX_REACH * slant / (MAX_SPACING * v)), 1.0, MAX_SIDE), spacing = MAX_REACH / side;
    vec3 sum = vec3(0.0), total = vec3(0.0);
    for (int part = 0; part < PARTS; ++part) {
        float deviation = alpha * sqrt(PART_VARIANCES[part]);
        for (float k = -side; k <= side; ++k) {
            float at = k * spacing;
            vec3 halfway = normalize(normal + outwards * (at * deviation * slant));
            float between = dot(view, halfway), height = dot(normal, halfway);
            vec3 direction = 2.0 * between * halfway - view;
            float light = dot(normal, direction);
            if (between <= 0.0 || light <= 0.0) continue;
            float smith = 2.0 * light * v / (light * sqrt(v * v * (1.0 - a2) + a2) + v * sqrt(light * light * (1.0 - a2) + a2));
            float grazing = 1.0 - between;
            vec3 fresnel = mix(reflectance, vec3(1.0), (grazing * grazing) * (grazing * grazing) * grazing);
            vec3 share = fresnel * (PART_WEIGHTS[part] * exp(-0.5 * at * at) * between * smith / (v * height));
            float across = 2.0 * between * deviation * height;
            float apart = 2.0 * spacing * deviation * slant * height * height / MAX_SPACING;
            sum += share * looked_up(direction, max(across * across, apart * apart));
            total += share;
        }
    }
    return ggx_albedo(reflectance, alpha, v) * sum / max(total, vec3(1e-20));
}
#endif

#if HAS_PHONG
// The cosine's slope moves the middle of what is reflected towards the normal.
vec3 reflected_phong(vec3 reflectance, float exponent, vec3 normal, vec3 view) {
    float v = clamp(dot(normal, view), 0.0, 1.0), variance = 1.0 / (exponent + 2.0), above = phong_above(v, sqrt(variance));
    float cosine = phong_cosine(v, sqrt(variance), above);
    vec3 mirrored = reflect(-view, normal);
    vec3 direction = mirrored + (normal - v * mirrored) * (variance * above / cosine);
    return reflectance * cosine * looked_up(direction, variance);
}
#endif

// What coarse pixels of the same surface reflect, w: how much of it there is.
#if PIXELS == WITH_COARSE
vec4 nearby(ivec2 pixel) {
    vec4 weights = texelFetch(coarse_weights, pixel, 0), sum = vec4(0.0);
    ivec2 first = pixel / STEP, last = textureSize(coarse_gloss, 0) - 1;
    for (int k = 0; k < 4; ++k) {
        if (weights[k] > 0.0) sum += weights[k] * texelFetch(coarse_gloss, min(first + ivec2(k & 1, k >> 1), last), 0);
    }
    return sum;
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int kind = int(surface_diffuse_at(pixel).kind);
    SurfaceSpecular specular = surface_specular_at(pixel);
#ifdef GL_ES  // which has no classes of pixels
    if (surface_depth_at(pixel).depth == 0.0 || (kind != MATERIAL_PHONG && kind != MATERIAL_GGX) || map_fraction(kind, specular.lobe) <= 0.0) discard;
#endif
    vec4 reflected = vec4(0.0);
#if PIXELS == WITH_COARSE
    reflected = nearby(pixel);
#else
    vec3 normal = surface_smooth_normal(pixel), view = -normalize(pixel_ray());
#if HAS_GGX
    if (kind == MATERIAL_GGX) reflected = vec4(reflected_ggx(specular.reflectance, specular.lobe, normal, view), 1.0);
#endif
#if HAS_PHONG
    if (kind == MATERIAL_PHONG) reflected = vec4(reflected_phong(specular.reflectance, specular.lobe, normal, view), 1.0);
#endif
#endif
#if PIXELS == COARSE
    radiance = reflected;
#else
    vec2 lit = texelFetch(lobe_visibility, pixel, 0).rg;
    float visible = lit.y > 0.0 ? lit.x / lit.y : 1.0, fraction = map_fraction(kind, specular.lobe);
    if (mirrors) visible = mix(visible, 1.0 - texelFetch(mirrored_scene, pixel, 0).a, scene_rays(kind, specular.lobe));
    radiance = vec4(reflected.rgb / max(reflected.a, 1e-6) * scale * (fraction * visible * weight), 0.0);
#endif
}
