// The scene under many lights, drawn in WebGL2 by the renderer's own shaders: surfaces once, then all lights for each pixel, then the screen.

import { Bounce } from "/relit_bounce.js";
import { Environment, withReflection } from "/relit_environment.js";
import { clipFromWorld, dot, minus, nearestDistance, rayFromPixel, unit } from "/relit_camera.js";
import { pointsOf, strongest, withPower } from "/relit_lights.js";
import { Meshes } from "/relit_meshes.js";
import { Mirrors } from "/relit_mirrors.js";
import { NearLights } from "/relit_near.js";
import { Programs } from "/relit_programs.js";
import { SceneRays } from "/relit_rays.js";
import { checkErrors, nearest, Shadows } from "/relit_shadows.js";
import { boxCorners, boxOf, identity, transformed, worldFromRest } from "/scene_data.js";

const FENCE_MS = 3; // between two looks at it; 1 to 10 would do
const NO_TONE = { scale: 1, white: 0 };

// The context, or a line that says why there is none.
export function contextOf(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: false, depth: false, premultipliedAlpha: false, powerPreference: "high-performance" });
  if (!gl) return { why: "this browser has no WebGL2: only the server draws the scene" };
  if (gl.isContextLost()) return { gl, why: "the graphics driver of this machine has taken the picture away" };
  if (!gl.getExtension("EXT_color_buffer_float")) return { why: "this browser's WebGL2 cannot draw into floats: only the server draws the scene" };
  return { gl };
}

export class SceneDrawing {
  constructor(gl, scene) {
    [this.gl, this.scene] = [gl, scene];
    const { description } = scene;
    this.laws = description.laws;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE), outputs = gl.getParameter(gl.MAX_DRAW_BUFFERS), largest = Math.max(...description.size, ...description.textures.flatMap(({ width, height }) => [width, height]));
    if (largest > most) throw new Error(`the scene has pictures of ${largest} texels a side, and this browser holds ${most}`);
    if (outputs < 4 + this.laws.EMISSION) throw new Error(`this browser's WebGL2 draws into ${outputs} pictures at once, and surfaces that shine take 5`);
    this.blends = Boolean(gl.getExtension("EXT_float_blend"));
    this.programs = new Programs(gl, description.shaders);
    this.empty = gl.createVertexArray();
    const bounces = this.laws.RAYS && scene.arrays.surfels;
    this.bounces = Boolean(bounces && outputs >= 5 + this.laws.EMISSION);
    this.missing = bounces && !this.bounces ? ["light from surface to surface, for which this browser draws into too few pictures at once"] : [];
    const { items, kinds, textures, white } = new Meshes(gl, scene, this.programs, this.bounces);
    Object.assign(this, { items, kinds, textures, white });
    this.shadows = new Shadows(gl, scene, this.programs);
    this.near = new NearLights(this);
    this.environment = new Environment(this);
    this.sceneRays = this.laws.RAYS ? new SceneRays(gl, scene) : null;
    this.mirrors = this.sceneRays && this.environment.glossy ? new Mirrors(this, this.sceneRays) : null;
    this.bounce = this.bounces ? new Bounce(this, this.sceneRays) : null;
    this.catches = this.kinds.includes(this.laws.KIND_SHADOW_CATCHER);
    this.size = [0, 0];
    checkErrors(gl);
  }

  // Draws a frame into the canvas.
  // view: { from, at, fov_y }; lights: directional ones, and near: the others, of lightsFromBytes(); poses: of objects; tone: { scale, white };
  // bounces: whether there is time for light from surface to surface.
  // Returns { lights, near, left, points, maps, coarser }: how many were drawn, near ones among them, and how many there was no room for; as how many
  // points; how many lights' shadow maps were drawn anew; how often all maps were halved so that they fit; settled: whether the next
  // picture of the same will be the same.
  draw({ view, lights, near, poses, tone, width, height, bounces = true }) {
    const bounce = bounces ? this.bounce : null, { gl, scene } = this, matrices = worldFromRest(scene, poses), lit = withPower(lights), shown = strongest(lit);
    const cut = pointsOf(shown, this.laws), points = this.environment.map ? withReflection(cut, this.environment.map, this.laws) : cut;
    const boxes = scene.objects.map((mesh, k) => (matrices[k] ? boxOf(boxCorners(mesh.box).flatMap((corner) => transformed(matrices[k], corner, 1))) : mesh.box));
    const anew = this.fit(width, height);
    const maps = this.shadows.draw(points, matrices, (common, first, count) => this.castAlpha(common, first, count, matrices));
    const nearMaps = this.near.drawMaps(near, matrices, boxes), nearCount = this.near.lights.length;
    const moved = this.sceneRays?.place(matrices), ground = this.catches ? this.groundAlbedo(view, points, matrices) : [0, 0, 0];
    if (moved) this.bounce?.place(matrices);
    bounce?.gather(ground, [lights, near, this.environment.map, ...ground]);
    this.drawSurfaces(view, matrices, boxes);
    this.sumLights(view, points, matrices, ground, bounce);
    if (this.laws.EMISSION) this.addEmission(this.surfaceTextures());
    if (this.environment.map && this.laws.BACKGROUND) this.environment.drawBehind(this.rays, this.catches ? this.matte : null);
    this.show(tone ?? NO_TONE);
    gl.bindVertexArray(null);
    if (anew) checkErrors(gl); // seldom, since it waits
    return {
      lights: shown.length + nearCount, near: nearCount, left: lit.length - shown.length, points: this.shadows.count, maps: maps + nearMaps,
      coarser: this.shadows.coarser, settled: bounce?.settled ?? true,
    };
  }

  // boxes: of the meshes, where they are now.
  drawSurfaces(view, matrices, boxes) {
    const { gl, size: [width, height] } = this, { description } = this.scene;
    const whole = boxCorners([0, 1].map((side) => [0, 1, 2].map((k) => { // as scene_pose.py has it: never smaller than at rest
      const rest = description.centre[k] + (side ? 1 : -1) * description.half[k];
      return (side ? Math.max : Math.min)(rest, ...boxes.map((box) => box[side][k]));
    })));
    const clip = clipFromWorld(view, width, height, whole, nearestDistance(view.from, boxes));
    this.rays = { eye: view.from, ray_from_pixel: rayFromPixel(view, width, height) };
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.surfaces);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.depthFunc(gl.LESS);
    this.targets.forEach((_, k) => gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]));
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    this.items.forEach((item, k) => {
      gl.bindVertexArray(item.array);
      gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, item.material.block);
      const [colour, parameter, normal, emissive] = item.material.textures.map((number) => (number === null ? this.white : this.textures[number]));
      item.program.use({
        ...this.rays, clip_from_world: clip, world_from_rest: matrices[k] ?? identity(), normal_from_rest: cofactors(matrices[k]), sample_number: 0,
        colour_texture: colour, parameter_texture: parameter, normal_texture: normal, emissive_texture: emissive,
        surfel_irradiance: this.bounce?.irradiance, back: item.back,
      });
      gl.drawElements(gl.TRIANGLES, item.indices.count, gl.UNSIGNED_INT, 4 * item.indices.first);
    });
  }

  // The sum over the lights. bounce: that is added to it, if any.
  sumLights(view, points, matrices, ground, bounce) {
    const { gl } = this;
    for (const frame of [this.picture.frame, this.picture.lobes, this.picture.matte]) {
      if (!frame) continue;
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
      if (frame !== this.picture.frame) gl.clearBufferfv(gl.COLOR, 1, [0, 0, 0, 0]);
    }
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    const surfaces = { ...this.rays, ...this.surfaceTextures() };
    for (const kind of this.kinds) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.frameOfKind(kind));
      this.shade(kind, { ...surfaces, unshadowed: kind === this.laws.KIND_SHADOW_CATCHER ? this.unshadowed(view, points, matrices) : [1, 1, 1] });
    }
    this.mirrors?.trace(surfaces, ground);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.picture.frame);
    this.near.add(surfaces, this.kinds.filter((kind) => kind !== this.laws.KIND_SHADOW_CATCHER));
    if (this.environment.map && this.environment.glossy && points.length) this.environment.addReflected({ ...surfaces, lobe_visibility: this.lobes }, this.mirrors?.scene);
    this.mirrors?.add(surfaces);
    bounce?.add(surfaces);
  }

  // Sums the lights for surfaces of a kind, into the frame that is bound.
  shade(kind, values, defines = {}, area) {
    const { frames, texture, width, height, count } = this.shadows;
    this.fill(this.programs.of("screen.vert", "shade.frag", { KIND: kind, CACHED_VISIBILITY: 0, WEAK: 0, COARSE: 0, STEP: 1, ...defines }), {
      lights_texture: frames.texture, atlas: texture, atlas_texel: [1 / width, 1 / height], light_count: count, weight: 1, alpha: 1, ...values,
    }, area);
  }

  // What places on surfaces that are given as such send out evenly, into the frame that is bound.
  lightPoints(values, area) {
    const points = { POINTS: 1 }, kind = this.laws.KIND_LAMBERT;
    this.shade(kind, values, points, area);
    this.near.add(values, [kind], points, area);
    if (this.laws.EMISSION) this.addEmission(values, area);
  }

  // What shading a kind of material writes beside radiance has a frame of its own.
  frameOfKind(kind) {
    const { KIND_SHADOW_CATCHER, KIND_PHONG, KIND_GGX } = this.laws;
    if (kind === KIND_SHADOW_CATCHER) return this.picture.matte;
    return kind === KIND_PHONG || kind === KIND_GGX ? this.picture.lobes : this.picture.frame;
  }

  // Adds what surfaces emit to the frame that is bound.
  addEmission(surfaces, area) {
    const { gl } = this;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    this.fill(this.programs.of("screen.vert", "emission.frag"), { ...surfaces, weight: 1 }, area);
    gl.disable(gl.BLEND);
  }

  // Tone-maps the picture as the server's is. The canvas has its first row below: relit.css turns it over.
  show({ scale, white }) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.fill(this.programs.of("screen.vert", "tonemap.frag", { EDGES: 0 }), { picture: this.picture.texture, scale, white: white || 1, exponential: white === 0 });
  }

  // Resolves when all that was drawn is there, while the page goes on.
  async finished() {
    const { gl } = this, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (fence && !gl.isContextLost() && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) await new Promise((go) => setTimeout(go, FENCE_MS));
    gl.deleteSync(fence);
  }

  // The linear picture drawn last, RGBA, the first row on top.
  readLinear() {
    const { gl, size: [width, height] } = this, pixels = new Float32Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.picture.frame);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, pixels);
    return pixels;
  }

  // Irradiance of the catcher without shadows.
  unshadowed(view, points, matrices) {
    return irradianceOn(this.catcherNormal(view, matrices), points).map((value) => Math.max(value, 1e-30));
  }

  // Of the ground that the catcher stands for: ground_albedo of bounce.py.
  groundAlbedo(view, points, matrices) {
    const normal = this.catcherNormal(view, matrices), down = irradianceOn(normal, points), up = irradianceOn(normal.map((value) => -value), points);
    return up.map((value, k) => (down[k] > 0 ? Math.min(value / down[k], 1) : 0));
  }

  // On the viewer's side.
  catcherNormal(view, matrices) {
    const number = this.scene.description.meshes.findIndex((_, k) => this.items[k].material.kind === this.laws.KIND_SHADOW_CATCHER), mesh = this.scene.objects[number];
    const at = (vector, w) => (matrices[number] ? transformed(matrices[number], vector, w) : [...vector]);
    const normal = unit(at(mesh.normals.subarray(0, 3), 0)), place = at(mesh.positions.subarray(0, 3), 1);
    return dot(minus(view.from, place), normal) < 0 ? normal.map((value) => -value) : normal;
  }

  castAlpha(common, first, count, matrices) {
    const { gl } = this;
    gl.disable(gl.CULL_FACE);
    this.items.forEach((item, k) => {
      if (!item.caster) return;
      gl.bindVertexArray(item.caster.array);
      item.caster.program.use({
        ...common, first_light: first, world_from_rest: matrices[k] ?? identity(), alpha_cutoff: item.material.cutoff,
        alpha_texture: item.caster.texture,
      });
      gl.drawElementsInstanced(gl.TRIANGLES, item.indices.count, gl.UNSIGNED_INT, 4 * item.indices.first, count);
    });
  }

  // Runs a program for all pixels of the frame that is bound, or of an area of it: [left, first row, width, height].
  fill(program, values, area = [0, 0, ...this.size]) {
    const { gl } = this;
    program.use({ depth: 0.5, ...values });
    gl.bindVertexArray(this.empty);
    gl.viewport(...area);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  surfaceTextures() {
    const [surface_depth, surface_normals, surface_diffuse, surface_specular, ...more] = this.targets;
    const surface_emission = this.laws.EMISSION ? more.shift() : null, [surface_received] = more;
    return { surface_depth, surface_normals, surface_diffuse, surface_specular, surface_emission, surface_received };
  }

  // Makes the textures of a picture of that size. Whether there were others.
  fit(width, height) {
    if (this.size[0] === width && this.size[1] === height) return false;
    const { gl } = this;
    this.size = [width, height];
    for (const texture of [...(this.targets ?? []), this.depth, this.picture?.texture, this.lobes, this.matte]) gl.deleteTexture(texture ?? null);
    for (const frame of [this.surfaces, this.picture?.frame, this.picture?.lobes, this.picture?.matte]) gl.deleteFramebuffer(frame ?? null);
    const formats = [gl.R32F, gl.RGBA32F, gl.RGBA16F, gl.RGBA16F, ...(this.laws.EMISSION ? [gl.RGBA32F] : []), ...(this.bounces ? [gl.RGBA32F] : [])];
    this.targets = formats.map((format) => this.target(format));
    this.depth = this.target(gl.DEPTH_COMPONENT24);
    this.surfaces = this.frameOf(this.targets, this.depth);
    this.picture = { texture: this.target(this.blends ? gl.RGBA32F : gl.RGBA16F) };
    this.picture.frame = this.frameOf([this.picture.texture]);
    if (this.environment.glossy) this.picture.lobes = this.frameOf([this.picture.texture, (this.lobes = this.target(gl.RG32F))]);
    if (this.catches) this.picture.matte = this.frameOf([this.picture.texture, (this.matte = this.target(gl.RGBA16F))]);
    this.mirrors?.fit();
    checkErrors(gl);
    [gl.canvas.width, gl.canvas.height] = [width, height];
    return true;
  }

  target(format) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, ...this.size);
    nearest(gl);
    return texture;
  }

  frameOf(textures, depth) {
    const { gl } = this, frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    textures.forEach((texture, k) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, texture, 0));
    if (depth) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
    gl.drawBuffers(textures.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      throw new Error(`this browser cannot draw into ${textures.length} pictures of floats at once`);
    }
    return frame;
  }
}

// What lights give a plane of this normal.
function irradianceOn(normal, lights) {
  const sum = [0, 0, 0];
  for (const { direction, irradiance } of lights) {
    const cosine = Math.max(dot(direction, normal), 0);
    irradiance.forEach((value, k) => { sum[k] += cosine * value; });
  }
  return sum;
}

// How normals turn with a matrix of 16 numbers, column by column; poses are rigid, so as it does.
function cofactors(matrix) {
  return matrix ? [0, 1, 2].flatMap((col) => [0, 1, 2].map((row) => matrix[4 * col + row])) : [1, 0, 0, 0, 1, 0, 0, 0, 1];
}
