// The cone about the mirrored view in which many weak lights stand in for the few (Havran et al. 2005, section 4.2). Its rim is soft,
// and what one set gives up the other adds, so that no light is counted twice or lost.

const vec2 WIDE_PHONG = vec2(4.0, 19.0);  // exponents from which on the cone fades in: lobes as wide as those of
const vec2 WIDE_GGX = vec2(0.36, 0.16);  // alphas of roughness 0.6 and 0.4, where few strong lights begin to be as good

uniform vec2 cone;  // cosines of its rim and of its core; above 1 where there is no second set

// How far the many lights take over a lobe of Phong's exponent or GGX' alpha.
float narrow_phong(float exponent) { return smoothstep(WIDE_PHONG.x, WIDE_PHONG.y, exponent); }
float narrow_ggx(float alpha) { return 1.0 - smoothstep(WIDE_GGX.y, WIDE_GGX.x, alpha); }

// Share of a narrow lobe that they have at a cosine between light and mirrored view.
float in_cone(float mirrored) { return smoothstep(cone.x, cone.y, mirrored); }
