#version 430
// The picture of the place behind everything, stretched over the picture.

uniform sampler2D plate;
uniform vec2 size;  // of the picture, pixels
layout(location = 0) out vec4 radiance;

void main() {
    radiance = vec4(texture(plate, gl_FragCoord.xy / size).rgb, 1.0);
}
