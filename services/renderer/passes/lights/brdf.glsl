// How surfaces reflect, by cosines between unit vectors: Lambert with normalised Phong, or GGX as glTF 2.0 has it (appendix B.3).

const float PI = 3.14159265358979;

// mirrored: between light and mirrored view.
float phong_lobe(float exponent, float mirrored) {
    return (exponent + 2.0) / (2.0 * PI) * pow(max(mirrored, 1e-6), exponent);
}

// Trowbridge-Reitz with the height-correlated Smith term; x: without Schlick's Fresnel term, y: how far that goes from f0 to 1.
// light, view: of the normal with either; between: of light and view.
vec2 ggx_lobe(float alpha, float light, float view, float between) {
    float size = sqrt(max(2.0 + 2.0 * between, 1e-12));  // of the sum of light and view, twice its cosine with either
    float n = min((light + view) / size, 1.0);
    float a2 = alpha * alpha;
    float t = n * n * (a2 - 1.0) + 1.0;
    float smith = light * sqrt(view * view * (1.0 - a2) + a2) + view * sqrt(light * light * (1.0 - a2) + a2);
    float grazing = 1.0 - min(0.5 * size, 1.0);
    return vec2(a2 / (PI * t * t) * 0.5 / smith, (grazing * grazing) * (grazing * grazing) * grazing);
}
