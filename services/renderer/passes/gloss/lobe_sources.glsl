// Which lobes reflect the prefiltered map and which the lights: after constants.glsl. Wide lobes are truer under the lights, which have their
// directions and shadows, narrow ones under the map, which has no dots; at roughness 0.4 both are as true (docs/looks.md).

const vec2 PHONG_FADE = vec2(6.0, 30.0);  // exponents: of lights alone, of the map alone
const vec2 GGX_FADE = vec2(0.25, 0.09);  // alphas: roughness 0.5 and 0.3

// Fraction of a lobe that reflects the map, by Phong's exponent or GGX' alpha.
float map_fraction(int kind, float lobe) {
    return kind == MATERIAL_PHONG ? smoothstep(PHONG_FADE.x, PHONG_FADE.y, lobe) : 1.0 - smoothstep(GGX_FADE.y, GGX_FADE.x, lobe);
}
