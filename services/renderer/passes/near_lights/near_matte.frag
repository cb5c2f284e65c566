#version 430
// The matte of shadow catchers once near lights are among those whose light falls on them, or, with `difference`, by how much the picture's alpha changes.
#include "constants.glsl"

uniform sampler2D matte;  // of the other lights: what shadows take, over `unshadowed`, times the part of the pixel that is a catcher
uniform vec3 unshadowed;  // irradiance by the other lights without shadows
uniform sampler2D near_taken;  // of near lights: what shadows take, times that part
uniform sampler2D near_unshadowed;  // irradiance without shadows, times that part, and in alpha the part
uniform bool difference;
layout(location = 0) out vec4 result;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 before = texelFetch(matte, pixel, 0), near = texelFetch(near_unshadowed, pixel, 0);
    vec4 after = before;
    if (near.a > 0.0) {
        vec3 whole = unshadowed + near.rgb / near.a;
        vec3 taken = before.rgb * unshadowed + texelFetch(near_taken, pixel, 0).rgb;
        after = vec4(taken / whole, dot(taken, LUMINANCE_WEIGHTS) / dot(whole, LUMINANCE_WEIGHTS));
    }
    result = difference ? vec4(0.0, 0.0, 0.0, after.a - before.a) : after;
}
