// The lights of a batch, as light_frames.comp made them; after constants.glsl and light_frame.glsl.

layout(std140) uniform Lights { LightFrame lights[MAX_LIGHTS]; };

uniform vec2 atlas_texel;  // 1 / (width, height) of the shadow atlas in texels
