#version 430
// Adds what surfaces send to each other, from the blocks of pixels for which it was gathered: between the middles of four blocks, as far as they
// lie on the pixel's own surface. CATCHERS: gives the irradiance of shadow catchers instead. COARSE: as shade.frag has it.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "scene_rays.glsl"

uniform float same_normal;  // exponent
uniform float same_plane;  // of the distance to the eye
uniform sampler2D block_places;  // about origin; w: 1 where there is a surface
uniform sampler2D block_normals;
uniform sampler2D block_irradiance;
uniform sampler2D block_mirrored;  // radiance about the mirrored view
uniform vec3 origin;
uniform float block;  // pixels on a side
uniform vec3 scale;
layout(location = 0) out vec4 radiance;
#if COARSE
#include "weak_lights.glsl"
layout(location = 1) out vec4 lobes;
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = surface_position(pixel);
    SurfaceDiffuse diffuse = surface_diffuse_at(pixel);
    bool catcher = int(diffuse.kind + 0.5) == MATERIAL_SHADOW_CATCHER;
    if (position.w == 0.0 || catcher != (CATCHERS == 1)) discard;
    vec3 normal = surface_smooth_normal(pixel), place = position.xyz - origin;
    float reach = same_plane * distance(position.xyz, eye);

    vec2 at = gl_FragCoord.xy / block - 0.5;  // in blocks, from the middle of the first
    ivec2 first = ivec2(floor(at)), last = textureSize(block_places, 0) - 1;
    vec2 part = at - vec2(first);
    vec3 irradiance = vec3(0.0), mirrored = vec3(0.0), any_irradiance = vec3(0.0), any_mirrored = vec3(0.0);
    float total = 0.0, any_total = 0.0;
    for (int y = 0; y <= 1; ++y) {
        for (int x = 0; x <= 1; ++x) {
            ivec2 texel = clamp(first + ivec2(x, y), ivec2(0), last);
            vec4 there = texelFetch(block_places, texel, 0);
            vec3 own = texelFetch(block_irradiance, texel, 0).rgb, own_mirrored = texelFetch(block_mirrored, texel, 0).rgb;
            float weight = there.w * (x == 0 ? 1.0 - part.x : part.x) * (y == 0 ? 1.0 - part.y : part.y);
            float cosine = max(dot(normal, texelFetch(block_normals, texel, 0).xyz), 0.0);
            any_irradiance += weight * own;
            any_mirrored += weight * own_mirrored;
            any_total += weight;
            float off = dot(normal, there.xyz - place) / reach;
            weight *= pow(cosine, same_normal) * exp(-off * off);
            irradiance += weight * own;
            mirrored += weight * own_mirrored;
            total += weight;
        }
    }
    // A surface that no block saw, such as a thin one, has what its neighbours have.
    bool known = total > 1e-3;
    irradiance = known ? irradiance / total : any_irradiance / max(any_total, 1e-9);
    mirrored = known ? mirrored / total : any_mirrored / max(any_total, 1e-9);
    SurfaceSpecular specular = surface_specular_at(pixel);
    mirrored *= 1.0 - scene_rays(int(diffuse.kind + 0.5), specular.lobe);  // the rest has rays of its own: mirrors.py
#if CATCHERS
    radiance = vec4(irradiance * scale, 0.0);
#elif COARSE
    radiance = vec4(irradiance / unshadowed_by_normal(normal), 0.0);
    lobes = vec4(specular.reflectance * mirrored, 0.0);
#else
    radiance = vec4((diffuse.albedo / 3.14159265 * irradiance + specular.reflectance * mirrored) * scale, 0.0);
#endif
}
