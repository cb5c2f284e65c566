// How surfaces reflect, from cosines between unit vectors: Lambert, normalised Phong, and GGX as in glTF 2.0, appendix B.3; after
// constants.glsl. The lobes are those of tests/support/ray_casting.py.

const float PI = 3.14159265358979;
const float MIN_LOBE_COSINE = 1e-4;  // in place of smaller ones where a lobe divides by them; any value in 1e-6 to 1e-3 does

// Normalised so that a mirror-like lobe seen from above reflects `specular` of the light (Lafortune and Willems 1994).
// mirrored: cosine between light and mirrored view.
float phong_lobe(float exponent, float mirrored) {
    return (exponent + 2.0) / (2.0 * PI) * pow(max(mirrored, 1e-6), exponent);
}

// Trowbridge-Reitz with the height-correlated Smith term. x: without Schlick's Fresnel term; y: how far that goes from f0 to 1.
// light, view: cosines of the normal with either; between: cosine of light and view.
vec2 ggx_lobe(float light, float view, float between, float alpha) {
    float size = sqrt(max(2.0 + 2.0 * between, 1e-12));  // of light + view, twice its cosine with either
    float n = min((light + view) / size, 1.0);
    float a2 = alpha * alpha;
    float t = n * n * (a2 - 1.0) + 1.0;
    float smith = light * sqrt(view * view * (1.0 - a2) + a2) + view * sqrt(light * light * (1.0 - a2) + a2);
    float grazing = 1.0 - min(0.5 * size, 1.0);
    return vec2(a2 / (PI * t * t) * 0.5 / smith, (grazing * grazing) * (grazing * grazing) * grazing);
}

// What a surface reflects: of the G-buffer, with the albedo over pi.
struct Reflection {
    vec3 lambert;
    vec3 reflectance;
    float lobe;
};

// The BRDF of a kind of material, with its lobe times lobe_weight. light, view, mirrored: as above; between: as ggx_lobe has it.
vec3 brdf(int kind, Reflection surface, float light, float view, float mirrored, float between, float lobe_weight) {
    if (kind == MATERIAL_GGX) {
        vec2 lobe = ggx_lobe(light, view, between, surface.lobe);
        vec3 fresnel = mix(surface.reflectance, vec3(1.0), lobe.y);
        return surface.lambert * (1.0 - fresnel) + fresnel * (lobe_weight * lobe.x);
    }
    if (kind == MATERIAL_PHONG) return surface.lambert + surface.reflectance * (lobe_weight * phong_lobe(surface.lobe, mirrored));
    return surface.lambert;
}
