// What surfaces send to each other: the scene's surfels (surfels.py) are lit as any surface is, and rays from each say which others it sees, one more of
// its rays a picture, until all are known; vertices then receive the mean of the surfels about them. When something moves, rays go anew one by one.

import { nearest } from "/relit_shadows.js";
import { transformed } from "/scene_data.js";

const NUMBERS = 16; // of a surfel
const FIRST_RAYS = 4; // of each surfel before the first picture; 2 to 8 would do
const OF_GROUND = -1; // in place of the albedo of a catcher

export class Bounce {
  // drawing: a SceneDrawing; rays: SceneRays.
  constructor(drawing, rays) {
    const { gl, laws, scene: { arrays, description, objects } } = drawing;
    Object.assign(this, { drawing, gl, rays, objects, surfels: arrays.surfels });
    [this.side, this.count] = [laws.SURFEL_SIDE, laws.SURFEL_RAYS];
    this.lift = laws.SURFEL_LIFT;
    this.points = ["places", "normals", "diffuse", "emission"].map(() => new Float32Array(4 * this.side ** 2));
    this.textures = this.points.map(() => this.storage(gl.RGBA32F, this.side, this.side));
    this.links = this.storage(gl.R32F, this.side * this.count, this.side);
    this.sent = this.storage(drawing.blends ? gl.RGBA32F : gl.RGBA16F, this.side, this.side);
    this.irradiance = this.storage(gl.RGBA32F, this.side, this.side);
    [this.linkFrame, this.sentFrame, this.frame] = [this.links, this.sent, this.irradiance].map((texture) => drawing.frameOf([texture]));
    this.ofVertices = rays.perVertex((vertex, k) => [arrays.vertex_surfels[2 * vertex] & 0xffff, description.meshes[k].back || -1]);
    [this.known, this.next, this.stale, this.light] = [0, 0, this.count, []];
  }

  get settled() {
    return !this.stale;
  }

  // Puts the surfels where the meshes are now. matrices: worldFromRest().
  place(matrices) {
    const [places, normals, diffuse, emission] = this.points, { surfels } = this;
    for (let k = 0, at = 0; at < surfels.length; k++, at += NUMBERS) {
      const part = (from) => surfels.subarray(at + from, at + from + 3), matrix = matrices[surfels[at + 3]];
      const normal = matrix ? transformed(matrix, part(4), 0) : part(4);
      places.set(matrix ? transformed(matrix, part(0), 1) : part(0), 4 * k);
      places[4 * k + 3] = 1;
      const [u, v] = octahedron(normal).map((value) => (value * 32767 + 32768) / 65535); // normals.glsl
      normals.set([u, v, u, v], 4 * k);
      diffuse.set([...part(8), this.drawing.laws.KIND_LAMBERT], 4 * k);
      emission.set(part(12), 4 * k);
    }
    this.textures.forEach((_, k) => this.write(k));
    this.stale = this.count;
  }

  // Finds what each surfel receives under the lights, once for each of them. ground: albedo of catchers; light: what the lights are, by identity.
  gather(ground, light) {
    if (!this.stale && light.every((part, k) => part === this.light[k])) return;
    this.light = light;
    const { gl, drawing, side } = this, { programs } = drawing, [surface_places, surface_normals, surface_diffuse, surface_emission] = this.textures;
    const values = { surface_places, surface_normals, surface_diffuse, surface_emission }, area = [0, 0, side, side];
    if (drawing.catches) this.colourGround(ground);
    gl.disable(gl.BLEND);
    gl.disable(gl.DEPTH_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.linkFrame);
    for (let k = this.known ? 1 : FIRST_RAYS; k > 0 && this.stale; k--) this.trace(values);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.sentFrame);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    drawing.lightPoints(values, area);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    drawing.fill(programs.of("screen.vert", "surfel_gather.frag"), { links: this.links, sent: this.sent, ray_count: this.known }, area);
  }

  trace(values) {
    const { drawing, rays, side, next, lift } = this;
    const program = drawing.programs.of("screen.vert", "surfel_links.frag", { ...rays.defines, POINTS: 1 });
    drawing.fill(program, { ...values, ...rays.values, ray_surfels: this.ofVertices, ray: next, lift }, [side * next, 0, side, side]);
    this.known = Math.max(this.known, next + 1);
    this.next = (next + 1) % this.count;
    this.stale -= 1;
  }

  // Adds what surfaces send to each other to the picture, whose frame is bound.
  add(surfaces) {
    const { gl, drawing } = this;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    drawing.fill(drawing.programs.of("screen.vert", "surfel_bounce.frag"), surfaces);
    gl.disable(gl.BLEND);
  }

  colourGround(ground) {
    const { surfels } = this;
    for (let k = 0, at = 0; at < surfels.length; k++, at += NUMBERS) if (surfels[at + 8] === OF_GROUND) this.points[2].set(ground, 4 * k);
    this.write(2);
  }

  write(number) {
    const { gl, side } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.textures[number]);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, side, side, gl.RGBA, gl.FLOAT, this.points[number]);
  }

  storage(format, width, height) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    nearest(gl);
    return texture;
  }
}

// octahedron_from_direction of normals.glsl.
function octahedron([x, y, z]) {
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z), [u, v] = [x / sum, y / sum], sign = (value) => (value >= 0 ? 1 : -1);
  return z >= 0 ? [u, v] : [(1 - Math.abs(v)) * sign(u), (1 - Math.abs(u)) * sign(v)];
}
