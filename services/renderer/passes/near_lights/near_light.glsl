// The near lights of a batch and what a surface receives of each without shadows; after constants.glsl and near_light_struct.glsl.

layout(std140) uniform NearLights { NearLight near_lights[NEAR_BATCH]; };

const float WIDE_SINE = 0.1;  // from which on a ball is no disc to a surface that sees it half; any value in 0.03 to 0.3 does
const float MAX_SINE = 0.999;  // of a ball that a surface touches
const float TURN = 6.28318531;

// A light as a surface sees it: the unit direction to its middle, the irradiance on a plane that faces it as a fraction of the intensity, 1/m^2, and the
// sine of its radius. From inside it is as from its surface.
struct NearView {
    vec3 direction;
    float strength;
    float sine;
};

NearView near_view(int i, vec3 position, vec3 normal) {
    vec3 v = near_lights[i].at - position;
    float distance = length(v), reach = max(distance, max(near_lights[i].radius, 1e-6));
    return NearView(distance > 1e-6 ? v / distance : normal, 1.0 / (reach * reach), min(near_lights[i].radius / reach, MAX_SINE));
}

// Irradiance as a fraction of that on a plane that faces the light, by the cosine of the surface's normal with its middle: of a ball that the
// horizon cuts (Snyder 1996), and of a small one, for which that cancels, the same of a flat disc.
float near_received(float cosine, float sine) {
    if (cosine >= sine) return cosine;
    if (cosine <= -sine) return 0.0;
    if (sine < WIDE_SINE) {
        float t = cosine / sine, rest = sqrt(max(1.0 - t * t, 0.0));
        return sine * (t * (0.25 * TURN + t * rest + asin(t)) + 2.0 / 3.0 * rest * rest * rest) * 2.0 / TURN;
    }
    float h2 = 1.0 / (sine * sine), x = sqrt(h2 - 1.0), across = sqrt(max(1.0 - cosine * cosine, 1e-12));
    float y = clamp(-x * cosine / across, -1.0, 1.0), rest = across * sqrt(1.0 - y * y);
    return (cosine * acos(y) - x * rest + h2 * atan(rest, x)) * 2.0 / TURN;
}
