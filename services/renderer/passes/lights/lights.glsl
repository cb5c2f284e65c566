// The batch, as frames.comp made it.
layout(std140) uniform Lights { LightFrame lights[MAX_LIGHTS]; };
