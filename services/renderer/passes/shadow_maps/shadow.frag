#version 430
#if defined(GL_ES) && RECEIVER_PLANE
in vec4 inside;
in float plane_depth;

void main() {
    if (any(lessThan(inside, vec4(0.0)))) discard;
    gl_FragDepth = clamp(plane_depth, 0.0, 1.0);
}
#else
void main() {}
#endif
