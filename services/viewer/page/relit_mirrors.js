// What polished surfaces show of the scene: a ray of each pixel, its end shaded as any surface is, and a filter over the pixel's lobe. The laws are those
// of rays/mirror.py and passes/mirrors.

export class Mirrors {
  // drawing: a SceneDrawing; rays: SceneRays.
  constructor(drawing, rays) {
    const { gl, programs, laws, kinds } = drawing;
    Object.assign(this, { drawing, gl, programs, laws, rays });
    this.constants = { HAS_PHONG: Number(kinds.includes(laws.KIND_PHONG)), HAS_GGX: Number(kinds.includes(laws.KIND_GGX)), ALBEDO_SIZE: laws.ALBEDO_SIZE.toFixed(1) };
  }

  // Makes the textures of pictures of that size.
  fit() {
    const { gl, drawing } = this;
    for (const texture of [...(this.ends ?? []), this.lit, this.scene]) gl.deleteTexture(texture ?? null);
    for (const frame of [this.endFrame, this.litFrame, this.frame]) gl.deleteFramebuffer(frame ?? null);
    this.ends = [gl.RGBA32F, gl.RGBA32F, gl.RGBA16F, gl.RGBA32F].map((format) => drawing.target(format));
    this.endFrame = drawing.frameOf(this.ends);
    const radiance = drawing.blends ? gl.RGBA32F : gl.RGBA16F;
    this.litFrame = drawing.frameOf([(this.lit = drawing.target(radiance))]);
    this.frame = drawing.frameOf([(this.scene = drawing.target(radiance))]);
  }

  // Finds what the surfaces' lobes show of the scene. surfaces: values of the G-buffer.
  trace(surfaces, ground) {
    const { gl, drawing, programs, rays } = this, [places, normals, diffuse, emission] = this.ends;
    for (const [frame, count] of [[this.endFrame, 4], [this.litFrame, 1], [this.frame, 1]]) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      for (let k = 0; k < count; k++) gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]);
    }
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.endFrame);
    drawing.fill(programs.of("screen.vert", "mirror_rays.frag", rays.defines), { ...surfaces, ...rays.values, ground });
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.litFrame);
    drawing.lightPoints({ surface_places: places, surface_normals: normals, surface_diffuse: diffuse, surface_emission: emission });
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    drawing.fill(programs.of("screen.vert", "mirror_filter.frag"), { ...surfaces, mirrored: this.lit, mirrored_places: places });
  }

  // Adds what was found to the picture, whose frame is bound.
  add(surfaces) {
    const { gl, drawing } = this;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    drawing.fill(this.programs.of("screen.vert", "mirrors.frag", this.constants), { ...surfaces, mirrored_scene: this.scene, albedo: drawing.environment.albedo, weight: 1 });
    gl.disable(gl.BLEND);
  }
}
