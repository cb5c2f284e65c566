// The cone about the mirrored view in which many weak lights stand in for the few (Havran et al. 2005, section 4.2). Its rim is soft,
// and what one set gives up the other adds, so that no light is counted twice or lost.

uniform vec2 cone;  // cosines of its rim and of its core; above 1 where there is no second set

// Share of a lobe that the many lights have at a cosine between light and mirrored view.
float in_cone(float mirrored) {
    return smoothstep(cone.x, cone.y, mirrored);
}
