// What a surface receives of a light without shadows; after lights.glsl. The function of services/light/extent.py.

const float SQRT_3 = 1.7320508;  // half the width of a box, in its standard deviations

// Irradiance as a fraction of light i's, by the cosine of the surface's normal with it: across a soft light's horizon the mean over a band.
float received(int i, float cosine) {
    if (lights[i].spread == 0.0) return max(cosine, 0.0);
    float width = SQRT_3 * lights[i].spread;
    float inside = clamp(cosine + width, 0.0, 2.0 * width);
    return lights[i].concentration * (inside * inside / (4.0 * width) + max(cosine - width, 0.0));
}
