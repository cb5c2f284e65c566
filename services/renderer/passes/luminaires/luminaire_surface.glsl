// The surface a pixel sees, in the luminaire's frame, its reflection, and the fraction of a map's light that reaches it; after brdf.glsl,
// cube_faces.glsl and gbuffer.glsl.

uniform mat4 local_from_world;
uniform sampler2D shadow_maps;
uniform bool catchers;  // the irradiance of shadow catchers; otherwise the radiance of all other surfaces
uniform float shadows;  // 1: maps are looked up; 0: all is lit

struct Surface { vec3 position, normal, flat_normal, mirrored; Reflection reflection; int kind; };

// False where the pixel sees no surface of those that are lit now.
bool surface_at(ivec2 pixel, out Surface surface) {
    vec4 position = surface_position(pixel);
    SurfaceDiffuse diffuse = surface_diffuse_at(pixel);
    if (position.w == 0.0 || catchers != (int(diffuse.kind) == MATERIAL_SHADOW_CATCHER)) return false;
    mat3 rotation = mat3(local_from_world);
    vec3 normal = surface_smooth_normal(pixel);
    SurfaceSpecular specular = surface_specular_at(pixel);
    surface.position = (local_from_world * vec4(position.xyz, 1.0)).xyz;
    surface.normal = rotation * normal;
    surface.flat_normal = rotation * surface_flat_normal(pixel);
    surface.mirrored = rotation * reflect(normalize(pixel_ray()), normal);
    surface.reflection = Reflection(catchers ? vec3(1.0) : diffuse.albedo / PI, specular.reflectance, specular.lobe);
    surface.kind = catchers ? MATERIAL_LAMBERT : int(diffuse.kind);
    return true;
}

// BRDF times cosine towards unit vector d.
vec3 reflected(Surface surface, vec3 d) {
    float cosine = dot(surface.normal, d);
    if (cosine <= 0.0 || dot(surface.flat_normal, d) <= 0.0) return vec3(0.0);
    float mirrored = dot(surface.mirrored, d);
    float view = max(dot(surface.normal, surface.mirrored), MIN_LOBE_COSINE);  // the view's cosine, as of its mirror
    return brdf(surface.kind, surface.reflection, cosine, view, mirrored, 2.0 * view * cosine - mirrored) * cosine;
}

// Fraction of the light of a map's cell that reaches the surface.
float map_visibility(int index, Surface surface) {
    if (shadows == 0.0) return 1.0;
    ShadowView view = views[index];
    vec3 q = through_face(surface.position - view.origin, view.face), n = through_face(surface.flat_normal, view.face);
    vec2 corner = map_corner(index) * map_size;
    return lit_by_own_plane(shadow_maps, vec2(map_size * map_columns), corner, map_size, view.low, view.high, inverse_depths, q, n);
}
