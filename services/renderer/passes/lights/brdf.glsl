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
// light, view: cosines of the normal with either; between: cosine of light and view; alpha: in the plane of normal and view and across it, where
// `aside` is the light's component.
vec2 ggx_lobe(float light, float view, float between, float aside, vec2 alpha) {
    float size = sqrt(max(2.0 + 2.0 * between, 1e-12));  // of light + view, twice its cosine with either
    float n = min((light + view) / size, 1.0), y = aside / size;
    vec2 a2 = alpha * alpha;
    float t = max(1.0 - n * n - y * y, 0.0) / a2.x + y * y / a2.y + n * n;
    float smith = light * sqrt(view * view * (1.0 - a2.x) + a2.x) + view * sqrt(light * light * (1.0 - a2.x) + a2.x);
    float grazing = 1.0 - min(0.5 * size, 1.0);
    return vec2(0.5 / (PI * alpha.x * alpha.y * t * t * smith), (grazing * grazing) * (grazing * grazing) * grazing);
}

// The same of one alpha.
vec2 ggx_lobe(float light, float view, float between, float alpha) { return ggx_lobe(light, view, between, 0.0, vec2(alpha)); }

// What a surface reflects: of the G-buffer, with the albedo over pi.
struct Reflection {
    vec3 lambert;
    vec3 reflectance;
    float lobe;
};

// The two parts of a BRDF.
struct Reflected {
    vec3 diffuse;
    vec3 lobe;
};

// The BRDF of a kind of material for a light of the variance `spread` along an axis, rad^2, which widens the lobe, to `least_width` at least:
// lights of which each stands for a part of something wider then overlap. Phong's lobe has the variance 1 / exponent. GGX' halfway vectors have
// about alpha^2 / 2; they move half as far as the light in the plane of incidence, and across it by 1 / (2 v.h) of its way.
// light, view, mirrored: as above; between, aside: as ggx_lobe has them.
Reflected reflected(
    int kind, Reflection surface, float light, float view, float mirrored, float between, float aside, float spread, float least_width) {
    if (kind == MATERIAL_GGX) {
        float a2 = surface.lobe * surface.lobe;
        vec2 axes = vec2(1.0, max(0.5 + 0.5 * between, MIN_LOBE_COSINE));  // 1 and (v.h)^2
        vec2 added = max(vec2(spread), least_width - 2.0 * a2 * axes);
        vec2 lobe = ggx_lobe(light, view, between, aside, sqrt(min(a2 + 0.5 * added / axes, 1.0)));
        vec3 fresnel = mix(surface.reflectance, vec3(1.0), lobe.y);
        return Reflected(surface.lambert * (1.0 - fresnel), fresnel * lobe.x);
    }
    if (kind == MATERIAL_PHONG) {
        float exponent = 1.0 / max(1.0 / max(surface.lobe, 1e-3) + spread, least_width);
        return Reflected(surface.lambert, surface.reflectance * phong_lobe(exponent, mirrored));
    }
    return Reflected(surface.lambert, vec3(0.0));
}

// The BRDF for a light of no extent.
vec3 brdf(int kind, Reflection surface, float light, float view, float mirrored, float between) {
    Reflected parts = reflected(kind, surface, light, view, mirrored, between, 0.0, 0.0, 0.0);
    return parts.diffuse + parts.lobe;
}
