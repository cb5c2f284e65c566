#version 430
// Every stride-th pixel of every stride-th row of a picture: `subsampled` of tonemap.py.

uniform sampler2D picture;
uniform int stride;
layout(location = 0) out vec4 pixel;

void main() { pixel = texelFetch(picture, stride / 2 + stride * ivec2(gl_FragCoord.xy), 0); }
