#version 430
// Casts no shadow where the alpha test fails. NEAR_LIGHT: nor within the light's radius.
#include "constants.glsl"
#include "alpha_test.glsl"

uniform sampler2D alpha_texture;
uniform float alpha_cutoff;
in vec2 alpha_uv_here;
in float alpha_here;  // without the texture's
in vec3 rest_position;
flat in uint sample_number;
#ifdef NEAR_LIGHT
in vec3 from_light;
flat in float light_radius;
#endif

void main() {
#ifdef NEAR_LIGHT
    if (dot(from_light, from_light) < light_radius * light_radius) discard;
#endif
    float nearest = textureLod(alpha_texture, alpha_uv_here, 0.0).r, mean = texture(alpha_texture, alpha_uv_here).r;
    if (fails_alpha_test(alpha_here * nearest, alpha_here * mean, alpha_cutoff, rest_position, sample_number)) discard;
}
