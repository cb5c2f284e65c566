// The cone about the mirrored view in which the gloss set, many lights, replaces the few shadowed ones (Havran et al. 2005, section 4.2). Its
// rim is soft, and what one set gives up the other adds, so that no light counts twice or is lost. After constants.glsl.

// Exponents and alphas over which the gloss set fades in. Wider lobes are as good with the few lights, which have a shadow map each.
const vec2 PHONG_FADE = vec2(4.0, 19.0);  // half widths at half height of 33 and 15 degrees
const vec2 GGX_FADE = vec2(0.36, 0.16);  // roughness 0.6 and 0.4

uniform vec2 cone;  // cosines of its rim and of its core; above 1 where there is no gloss set

// Fraction of a lobe inside the cone that the gloss set has, by Phong's exponent or GGX' alpha.
float gloss_fraction(int kind, float lobe) {
    return kind == MATERIAL_PHONG ? smoothstep(PHONG_FADE.x, PHONG_FADE.y, lobe) : 1.0 - smoothstep(GGX_FADE.y, GGX_FADE.x, lobe);
}

// How far a direction lies inside the cone, 0 to 1; mirrored: its cosine with the mirrored view.
float in_cone(float mirrored) { return smoothstep(cone.x, cone.y, mirrored); }
