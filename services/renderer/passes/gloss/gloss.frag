#version 430
// Adds what the many weak lights of the second set give to the lobes of glossy surfaces: those in the cone about the mirrored view, from
// the row of the region that it lies in. Each is shadowed by the map of the strong light nearest to it, which its group shares. PHONG, GGX:
// whether there are such surfaces. LINE: groups or lights in a line of their textures.

#include "light.glsl"
#include "lights.glsl"
#include "visibility.glsl"
#include "normals.glsl"
#include "gbuffer.glsl"
#include "brdf.glsl"
#include "cone.glsl"

uniform float weight;  // of this pass in the picture: 1 / samples
uniform sampler2D surface_diffuse;
uniform sampler2D surface_specular;
uniform samplerCube region_of_direction;
uniform sampler2D spans;  // of each region: its first group, and how many
uniform sampler2D groups;  // line after line: the strong light, the group's first weak light, and how many
// Line after line, two texels a light: direction; irradiance and the square of its spread, rad. A disc of that radius has a quarter of the
// square as variance along an axis. Phong's lobe has 1 / exponent, GGX' lobe of halfway vectors, which move half as far as the light, about
// alpha^2 / 2.
uniform sampler2D weak_lights;
layout(location = 0) out vec4 radiance;

#if PHONG
vec3 phong(vec4 specular, vec4 irradiance, float mirrored) {
    return specular.rgb * phong_lobe(1.0 / (1.0 / max(specular.w, 1e-3) + 0.25 * irradiance.w), mirrored);
}
#endif

#if GGX
vec3 ggx(vec4 specular, vec4 irradiance, float mirrored, float cosine, float view_cosine) {
    vec2 facets = ggx_lobe(sqrt(specular.w * specular.w + 0.125 * irradiance.w), cosine, view_cosine, 2.0 * view_cosine * cosine - mirrored);
    return mix(specular.rgb, vec3(1.0), facets.y) * facets.x;
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = seen_position();
    float kind = texelFetch(surface_diffuse, pixel, 0).w;
    if (position.w == 0.0 || kind < 0.5 || kind > 2.5) discard;
    vec4 specular = texelFetch(surface_specular, pixel, 0);
#if PHONG && GGX
    bool phongs = kind < 1.5;
    float narrow = phongs ? narrow_phong(specular.w) : narrow_ggx(specular.w);
#elif PHONG
    float narrow = narrow_phong(specular.w);
#else
    float narrow = narrow_ggx(specular.w);
#endif
    if (narrow == 0.0) discard;
    vec4 normals = seen_normals();
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
    vec3 mirrored_view = reflect(normalize(seen_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), 1e-4);
    int region = int(textureLod(region_of_direction, mirrored_view, 0.0).r);
    ivec2 span = ivec2(texelFetch(spans, ivec2(region, 0), 0).xy);

    vec3 sum = vec3(0.0);
    for (int g = span.x; g < span.x + span.y; ++g) {
        ivec3 group = ivec3(texelFetch(groups, ivec2(g % LINE, g / LINE), 0).xyz);
        vec3 part = vec3(0.0);
        for (int k = group.y; k < group.y + group.z; ++k) {
            ivec2 place = ivec2(2 * (k % LINE), k / LINE);
            vec3 direction = texelFetch(weak_lights, place, 0).xyz;
            float mirrored = dot(mirrored_view, direction);
            float share = in_cone(mirrored);
            float cosine = dot(smooth_normal, direction);
            if (share <= 0.0 || cosine <= 0.0 || dot(flat_normal, direction) <= 0.0) continue;
            vec4 irradiance = texelFetch(weak_lights, place + ivec2(1, 0), 0);
#if PHONG && GGX
            vec3 lobe = phongs ? phong(specular, irradiance, mirrored) : ggx(specular, irradiance, mirrored, cosine, view_cosine);
#elif PHONG
            vec3 lobe = phong(specular, irradiance, mirrored);
#else
            vec3 lobe = ggx(specular, irradiance, mirrored, cosine, view_cosine);
#endif
            part += irradiance.rgb * lobe * (share * cosine);
        }
        float over = dot(flat_normal, lights[group.x].direction.xyz);
        sum += part * (over > 0.0 ? visibility(group.x, position, flat_normal, over) : 1.0);  // a map knows nothing of what it lies behind
    }
    radiance = vec4(sum * (narrow * weight), 0.0);
}
