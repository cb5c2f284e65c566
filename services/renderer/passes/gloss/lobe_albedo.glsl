// How much of even light a lobe reflects; after constants.glsl. HAS_PHONG, HAS_GGX: whether there are such surfaces.

#if HAS_GGX
uniform sampler2D albedo;  // lobe_albedo.py

// view: cosine.
vec3 ggx_albedo(vec3 reflectance, float alpha, float view) {
    vec2 at = vec2(sqrt(view), clamp((sqrt(alpha) - MIN_ROUGHNESS) / (1.0 - MIN_ROUGHNESS), 0.0, 1.0));
    vec2 ab = textureLod(albedo, (at * (ALBEDO_SIZE - 1.0) + 0.5) / ALBEDO_SIZE, 0.0).rg;
    return reflectance * ab.x + ab.y;
}
#endif

#if HAS_PHONG
// Phong's lobe has the variance 1 / (exponent + 2) along an axis, and the mean of the light's cosine over it is the mirrored view's, cut off at
// the horizon: the mean of a Gaussian above 0.

// The part of the lobe above the horizon.
float phong_above(float view, float deviation) {
    float x = view / deviation;
    return 1.0 / (1.0 + exp(-x * (1.5976 + 0.07056 * x * x)));  // the normal distribution within 2e-4 (Bowling et al. 2009)
}

float phong_cosine(float view, float deviation, float above) {
    float x = view / deviation;
    return view * above + deviation * 0.39894228 * exp(-0.5 * x * x);
}
#endif
