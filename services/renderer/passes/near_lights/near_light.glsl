// The near lights of a batch and what a surface receives of each without shadows; after constants.glsl and near_light_struct.glsl.

layout(std140) uniform NearLights { NearLight near_lights[NEAR_BATCH]; };

const float MAX_SINE = 0.999;  // of a ball that a surface touches

// A light as a surface sees it: the unit direction to its middle, the irradiance on a plane that faces it as a fraction of the intensity, 1/m^2, and the
// sine of its radius. From inside it is as from its surface.
struct NearView {
    vec3 direction;
    float strength;
    float sine;
};

NearView near_view(int i, vec3 position, vec3 normal) {
    vec3 v = near_lights[i].at - position;
    float distance = length(v), reach = max(distance, max(near_lights[i].radius, MIN_DISTANCE_M));
    return NearView(distance > 1e-6 ? v / distance : normal, 1.0 / (reach * reach), min(near_lights[i].radius / reach, MAX_SINE));
}

// Irradiance as a fraction of that on a plane that faces the light, by the cosine of the surface's normal with its middle: where the horizon cuts it
// that of a flat disc, in t = cosine / sine t / 2 + (t^2 w + t asin t + 2/3 w^3) / pi with w = sqrt(1 - t^2), within .0012 of the sine by a
// polynomial with its values at 0 and 1 and its slope there. A ball of 30 degrees gives .9 % of what it does to a plane that faces it more.
float near_received(float cosine, float sine) {
    float t = clamp(cosine / max(sine, 1e-6), -1.0, 1.0), t2 = t * t;
    return sine * (0.5 * t + 0.21221 + t2 * (0.32558 - 0.03779 * t2)) + max(cosine - sine, 0.0);
}
