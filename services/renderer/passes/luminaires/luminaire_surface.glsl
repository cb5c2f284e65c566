// The surface a pixel sees, in the luminaire's frame, its reflection, and the fraction of a map's light that reaches it; after brdf.glsl and
// gbuffer.glsl.

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

const float MAP_BIAS = 0.5;  // texels: what a surface may rise above its tangent plane within a texel
const float MIN_COSINE = 0.03;  // a receiver at a flatter angle is treated as facing the map

// Fraction of the light of a map's cell that reaches the surface: bilinear over the four texels around it, each compared with the receiver's
// own plane at that texel; 1 outside the map.
float map_visibility(int index, Surface surface) {
    ShadowView view = views[index];
    vec3 q = through_face(surface.position - view.origin, view.face);
    vec3 n = through_face(surface.flat_normal, view.face);
    if (shadows == 0.0 || q.z * inverse_depths.x <= 1.0) return 1.0;
    vec2 texel = (view.high - view.low) / map_size;
    vec2 at = (q.xy / q.z - view.low) / texel;
    if (any(lessThan(at, vec2(1.0))) || any(greaterThan(at, vec2(map_size - 1.0)))) return 1.0;
    vec2 corner = floor(at - 0.5);
    vec2 f = at - 0.5 - corner;
    vec4 stored = textureGather(shadow_maps, (map_corner(index) * map_size + corner + 1.0) / (map_size * map_columns));
    float height = dot(n, q);
    bool grazing = abs(height) < MIN_COSINE * length(q);
    vec2 tangent = view.low + (corner + 0.5) * texel;
    vec4 inverse;
    for (int k = 0; k < 4; ++k) {
        vec2 side = vec2(k == 1 || k == 2 ? 1.0 : 0.0, k < 2 ? 1.0 : 0.0);  // the order of textureGather
        inverse[k] = grazing ? 1.0 / q.z : dot(n, vec3(tangent + side * texel, 1.0)) / height;
    }
    inverse *= 1.0 + MAP_BIAS * max(texel.x, texel.y);
    vec4 own = (inverse_depths.x - inverse) / (inverse_depths.x - inverse_depths.y);
    vec4 lit = vec4(lessThanEqual(min(own, 1.0), stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    return mix(side.x, side.y, f.y);
}
