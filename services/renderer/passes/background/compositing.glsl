// What lies behind the picture shows where surfaces leave it open, less what the matte of shadow catchers takes of it in each channel. The
// picture's alpha has the matte in luminance alone, which blending takes: the difference is added by a pass of its own.

uniform sampler2D matte;  // of shadow catchers: the fraction taken in each channel, alpha: in luminance
uniform bool difference;

vec4 composited(vec3 radiance) {
    if (!difference) return vec4(radiance, 1.0);
    vec4 taken = texelFetch(matte, ivec2(gl_FragCoord.xy), 0);
    return vec4(radiance * (taken.a - taken.rgb), 0.0);
}
