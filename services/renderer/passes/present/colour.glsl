// The functions of vemlight.light.colour; after constants.glsl.

float luminance_from_rgb(vec3 rgb) { return dot(rgb, LUMINANCE_WEIGHTS); }

vec3 srgb_from_linear(vec3 linear) {
    vec3 curve = (1.0 + SRGB_OFFSET) * pow(linear, vec3(1.0 / SRGB_GAMMA)) - SRGB_OFFSET;
    return mix(curve, SRGB_SLOPE * linear, lessThanEqual(linear, vec3(SRGB_LINEAR_END)));
}
