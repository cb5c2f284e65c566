#version 430
// A luminaire from its far-field photometry: a point with an intensity over direction, and a shadow map through each face of a cube.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "shadow_view.glsl"
#include "cube_faces.glsl"
#include "luminaire_maps.glsl"
#include "brdf.glsl"
#include "luminaire_surface.glsl"

uniform sampler2D candela;  // columns: C from 0 to 360 degrees; rows: gamma from 0 to 180 degrees; both ends on texel centres
uniform vec3 scale;
layout(location = 0) out vec4 radiance;

void main() {
    Surface surface;
    if (!surface_at(ivec2(gl_FragCoord.xy), surface)) discard;
    vec3 p = surface.position;
    float r = length(p);
    vec3 value = reflected(surface, -p / r);
    if (value == vec3(0.0) || r == 0.0) discard;
    vec2 angles = vec2(fract(atan(p.y, p.x) / (2.0 * PI)), atan(length(p.xy), p.z) / PI);
    vec2 size = vec2(textureSize(candela, 0));
    float strength = texture(candela, (angles * (size - 1.0) + 0.5) / size).r;
    float visibility = map_visibility(face_of(p), surface);
    radiance = vec4(value * scale * (strength / (r * r) * visibility), 0.0);
}
