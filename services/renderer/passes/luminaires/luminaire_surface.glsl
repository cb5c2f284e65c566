// The surface a pixel sees, in the luminaire's frame, its reflection, and the fraction of a map's light that reaches it; after brdf.glsl and
// gbuffer.glsl.

uniform mat4 local_from_world;
uniform sampler2D surface_diffuse;
uniform sampler2D surface_specular;
uniform sampler2D shadow_maps;
uniform bool catchers;  // the irradiance of shadow catchers; otherwise the radiance of all other surfaces
uniform float shadows;  // 1: maps are looked up; 0: all is lit

struct Surface { vec3 position, normal, flat_normal, mirrored, lambert, specular; float shape, kind; };

// False where the pixel sees no surface of those that are lit now.
bool surface_at(ivec2 pixel, out Surface surface) {
    vec4 position = seen_position();
    vec4 diffuse = texelFetch(surface_diffuse, pixel, 0);
    if (position.w == 0.0 || catchers != (diffuse.w > 2.5)) return false;
    vec4 normals = seen_normals();
    mat3 rotation = mat3(local_from_world);
    vec3 normal = direction_from_octahedron(normals.xy);
    vec4 specular = texelFetch(surface_specular, pixel, 0);
    surface.position = (local_from_world * vec4(position.xyz, 1.0)).xyz;
    surface.normal = rotation * normal;
    surface.flat_normal = rotation * direction_from_octahedron(normals.zw);
    surface.mirrored = rotation * reflect(normalize(seen_ray()), normal);
    surface.lambert = catchers ? vec3(1.0) : diffuse.rgb / PI;
    surface.specular = specular.rgb;
    surface.shape = specular.w;
    surface.kind = catchers ? 0.0 : diffuse.w;
    return true;
}

// BRDF times cosine towards unit vector d.
vec3 reflected(Surface surface, vec3 d) {
    float cosine = dot(surface.normal, d);
    if (cosine <= 0.0 || dot(surface.flat_normal, d) <= 0.0) return vec3(0.0);
    float mirrored = dot(surface.mirrored, d);
    if (surface.kind < 2.0) return (surface.lambert + surface.specular * phong_lobe(surface.shape, mirrored)) * cosine;
    float view = max(dot(surface.normal, surface.mirrored), 1e-4);  // the view's cosine, as of its mirror
    vec2 lobe = ggx_lobe(surface.shape, cosine, view, 2.0 * view * cosine - mirrored);
    vec3 fresnel = mix(surface.specular, vec3(1.0), lobe.y);
    return (surface.lambert * (1.0 - fresnel) + fresnel * lobe.x) * cosine;
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
