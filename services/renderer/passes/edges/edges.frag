#version 430
// Writes as a depth whether a pixel has parts of its neighbours' colours.
uniform sampler2D edges_before;
uniform sampler2D edges_after;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 parts = texelFetch(edges_before, pixel, 0) + texelFetch(edges_after, pixel, 0);
    gl_FragDepth = dot(parts, vec4(1.0)) > 0.0 ? ON_EDGE : OFF_EDGE;
}
