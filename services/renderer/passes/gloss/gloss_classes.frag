#version 430
// Writes as a depth how a pixel gets what its lobe reflects of the map: by itself, from the coarse pixels about it, which have it if their lobes are
// wide, or not at all. PIXELS: all, those of coarse surfaces, or all beside coarse ones.
#include "constants.glsl"
#include "surface_texels.glsl"
#include "lobe_sources.glsl"

#if PIXELS == WITH_COARSE
uniform sampler2D coarse_weights;
uniform sampler2D coarse_diffuse;
uniform sampler2D coarse_specular;
#endif

// Of a lobe that coarse pixels show as well, roughness 0.2: half its width of 4.6 degrees is more than a curved thing turns from pixel to pixel.
const float WIDE_ALPHA = 0.04;
const float LEAST_NEAR = 0.5;  // of the weights of the coarse pixels about a pixel that have a wide lobe

bool is_glossy(int kind, float lobe) { return (kind == MATERIAL_PHONG || kind == MATERIAL_GGX) && map_fraction(kind, lobe) > 0.0; }
bool is_wide(int kind, float lobe) { return kind == MATERIAL_GGX && lobe >= WIDE_ALPHA; }

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int kind = int(surface_diffuse_at(pixel).kind + 0.5);
    float lobe = surface_specular_at(pixel).lobe;
    bool glossy = surface_depth_at(pixel).depth > 0.0 && is_glossy(kind, lobe), wide = is_wide(kind, lobe);
#if PIXELS == WITH_COARSE
    vec4 weights = texelFetch(coarse_weights, pixel, 0);
    ivec2 first = pixel / STEP, last = textureSize(coarse_diffuse, 0) - 1;
    float near = 0.0;
    for (int k = 0; k < 4; ++k) {
        ivec2 texel = min(first + ivec2(k & 1, k >> 1), last);
        int its_kind = int(texelFetch(coarse_diffuse, texel, 0).w + 0.5);
        float its_lobe = texelFetch(coarse_specular, texel, 0).w;
        near += is_glossy(its_kind, its_lobe) && is_wide(its_kind, its_lobe) ? weights[k] : 0.0;
    }
    wide = wide && near >= LEAST_NEAR;
#endif
    gl_FragDepth = !glossy ? 1.0 : wide ? GLOSS_WIDE : GLOSS_NARROW;
}
