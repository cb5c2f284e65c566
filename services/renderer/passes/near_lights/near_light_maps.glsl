// Shadow maps of near lights in one depth texture, six of each; after near_light.glsl, near_shadow_view.glsl and cube_faces.glsl.

layout(std140, binding = 4) readonly buffer NearViews { NearShadowView near_views[]; };

uniform sampler2D near_maps;
uniform float map_size;  // texels of a tile's side

// Fraction of near light i that reaches a surface; 1 within its radius, and where no receiver was known of.
float near_visibility(int i, vec3 position, vec3 flat_normal) {
    int first = 6 * int(near_lights[i].layer);
    vec3 away = position - near_views[first].origin;  // where the light stood when they were drawn, as all six have it
    NearShadowView view = near_views[first + face_of(away)];
    if (any(lessThanEqual(view.high, view.low)) || dot(away, away) <= view.radius * view.radius) return 1.0;
    if (dot(flat_normal, away) >= 0.0) return 0.0;
    vec3 q = through_face(away, view.face), n = through_face(flat_normal, view.face);
    return lit_by_own_plane(near_maps, vec2(textureSize(near_maps, 0)), view.corner, map_size, view.low, view.high, view.inverse_depths, q, n);
}
