// What lies behind the picture fills what surfaces leave open, less what catchers take of it in each channel. The picture's alpha says
// the latter in luminance alone: the difference is added by itself.

uniform sampler2D cover;  // of catchers: a share in each channel, and that of luminance
uniform bool difference;

vec4 behind(vec3 radiance) {
    if (!difference) return vec4(radiance, 1.0);
    vec4 taken = texelFetch(cover, ivec2(gl_FragCoord.xy), 0);
    return vec4(radiance * (taken.a - taken.rgb), 0.0);
}
