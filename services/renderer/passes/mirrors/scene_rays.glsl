// How much of what a lobe reflects of the scene is found by rays of its own, the rest by the bounce's wide lobe; after constants.glsl.

const float GATHERED_VARIANCE = 0.1;  // rad^2 along an axis, of the bounce's lobe: 1 / (rays.bounce.MIRROR_EXPONENT + 2)

// Phong's lobe has the variance 1 / (exponent + 2); GGX' halfway vectors have about alpha^2 / 2, and turn half as far.
float scene_rays(int kind, float lobe) {
    float variance = kind == MATERIAL_PHONG ? 1.0 / (lobe + 2.0) : 2.0 * lobe * lobe;
    return 1.0 - smoothstep(0.5 * GATHERED_VARIANCE, GATHERED_VARIANCE, variance);
}
