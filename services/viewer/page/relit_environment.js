// The environment map in the browser's picture: behind the scene, and in what is polished. It is prefiltered by the renderer's shaders, and its laws are
// the renderer's: environment_binary.py, reflected_light.py, prefiltered_map.py.

import { VIRTUAL_IDS_FROM } from "/constants.js";
import { dot } from "/relit_camera.js";
import { checkErrors } from "/relit_shadows.js";

const LAYOUT = 1, HEAD_BYTES = 32, SOURCE_BYTES = 32; // environment_binary.py
const SAME_COSINE = Math.cos((5 * Math.PI) / 180); // of a source and its light, which moves and gets other numbers between two maps. 3 to 10 degrees would do
const PIXELS = { ALL: 0, COARSE: 1, WITH_COARSE: 2 }; // gloss.py

// { coverage, rows, cols, unit, scale, sources: [{ id, direct, spread, leastWidth, direction }], words, rest } of the feed environment.bin.
export async function environmentFromBytes(bytes) {
  const head = new DataView(bytes);
  if (bytes.byteLength < HEAD_BYTES || head.getUint8(1) !== LAYOUT) throw new Error("a map in a layout that is not known: reload the page");
  const rows = head.getUint16(4, true), cols = head.getUint16(6, true), count = head.getUint32(8, true), changed = head.getUint32(12, true);
  const buffer = await new Response(new Blob([new Uint8Array(bytes, HEAD_BYTES)]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  const view = new DataView(buffer), first = SOURCE_BYTES * count;
  if (buffer.byteLength !== first + 4 * rows * cols + 8 * changed) throw new Error("a map of another length than it says");
  const number = (at) => view.getFloat32(at, true), numbers = (from, at) => [0, 4, 8].map((more) => from.getFloat32(at + more, true));
  const sources = Array.from({ length: count }, (_, k) => SOURCE_BYTES * k).map((at) => ({
    id: view.getFloat64(at, true), direct: number(at + 8), spread: number(at + 12), leastWidth: number(at + 16), direction: numbers(view, at + 20),
  }));
  const words = new Uint32Array(buffer, first, rows * cols), rest = words.slice(), cells = new Uint32Array(buffer, first + 4 * rows * cols, changed);
  new Uint32Array(buffer, first + 4 * (rows * cols + changed), changed).forEach((word, k) => { rest[cells[k]] = word; });
  const unit = head.getFloat32(16, true), scale = numbers(head, 20);
  return { coverage: head.getUint8(2) ? "sphere" : "hemisphere", rows, cols, unit, scale, sources, words, rest };
}

// The points with what lobes reflect of each, as reflected_light.py has it: { direct, spread, leastWidth }.
export function withReflection(points, environment, laws) {
  const own = points.filter(({ id }) => id < VIRTUAL_IDS_FROM), known = sourcesOf(own, environment.sources), apart = neighbourDistances(own, laws.NEIGHBOURS);
  const reflected = new Map(own.map((point, k) => [point, {
    direct: 0, spread: laws.CELL_VARIANCE * apart[k] ** 2, leastWidth: (laws.GAUSSIAN_SPACING * apart[k]) ** 2, ...known.get(point),
  }]));
  return points.map((point) => ({ ...point, ...(reflected.get(point) ?? { direct: 1, spread: point.variance ?? 0, leastWidth: 0 }) }));
}

// By point: the source that it is, of the same number, or else the nearest to it.
function sourcesOf(points, sources) {
  const found = new Map();
  for (const { id, direction, ...source } of sources) {
    let best = null, nearest = SAME_COSINE;
    for (const point of points) {
      const cosine = dot(point.direction, direction) + (point.id === id ? 1 : 0);
      if (cosine >= nearest && !found.has(point) && dot(point.direction, direction) >= SAME_COSINE) [best, nearest] = [point, cosine];
    }
    if (best) found.set(best, source);
  }
  return found;
}

// The mean distance of each point to those nearest to it.
function neighbourDistances(points, neighbours) {
  const count = Math.min(neighbours, points.length - 1), places = Float64Array.from(points.flatMap(({ direction }) => direction)), nearest = new Float64Array(count);
  return points.map((_, i) => {
    if (count < 1) return 0;
    nearest.fill(Infinity);
    for (let j = 0; j < points.length; j++) {
      if (j === i) continue;
      let square = 0, k = count - 1;
      for (let axis = 0; axis < 3; axis++) square += (places[3 * i + axis] - places[3 * j + axis]) ** 2;
      if (square >= nearest[k]) continue;
      for (; k > 0 && nearest[k - 1] > square; k--) nearest[k] = nearest[k - 1];
      nearest[k] = square;
    }
    return nearest.reduce((sum, square) => sum + Math.sqrt(square), 0) / count;
  });
}

export class Environment {
  // drawing: a SceneDrawing, which draws surfaces and lights.
  constructor(drawing) {
    const { gl, scene, laws, programs, kinds } = drawing, { KIND_PHONG, KIND_GGX } = laws;
    Object.assign(this, { drawing, gl, laws, programs });
    this.map = null;
    this.polar = this.texture();
    const has = { HAS_PHONG: Number(kinds.includes(KIND_PHONG)), HAS_GGX: Number(kinds.includes(KIND_GGX)) };
    this.glossy = Boolean(has.HAS_PHONG || has.HAS_GGX);
    if (!this.glossy) return;
    this.constants = { ...has, ...PIXELS, PIXELS: PIXELS.ALL, ALBEDO_SIZE: laws.ALBEDO_SIZE.toFixed(1) };
    this.albedo = this.texture();
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG16F, laws.ALBEDO_SIZE, laws.ALBEDO_SIZE, 0, gl.RG, gl.FLOAT, scene.arrays.lobe_albedo);
    this.rest = this.texture();
    this.prefiltered = this.texture(gl.LINEAR_MIPMAP_LINEAR);
    gl.texStorage2D(gl.TEXTURE_2D, laws.LEVELS, gl.RGBA16F, laws.PREFILTER_SIDE, laws.PREFILTER_SIDE);
    this.frame = gl.createFramebuffer();
  }

  // Takes a map of environmentFromBytes(); null: there is none.
  take(map) {
    this.map = map;
    if (!map) return;
    if (this.laws.BACKGROUND) this.upload(this.polar, map, map.words);
    if (this.glossy) this.prefilter(map);
    checkErrors(this.gl);
  }

  upload(texture, { rows, cols }, words) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB9_E5, cols, rows, 0, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, words);
  }

  get span() {
    return this.map.coverage === "sphere" ? Math.PI : Math.PI / 2;
  }

  prefilter(map) {
    const { gl, laws } = this, cell = Math.max(this.span / map.rows, (2 * Math.PI) / map.cols);
    let side = laws.PREFILTER_SIDE, texel = laws.PREFILTER_TEXEL_RAD;
    this.variance = cell ** 2 / 6 + texel ** 2 / 6;
    this.upload(this.rest, map, map.rest);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.disable(gl.BLEND);
    gl.disable(gl.DEPTH_TEST);
    for (let level = 0; level < laws.LEVELS; level++, side /= 2, texel *= 2) {
      const variance = this.variance * 4 ** level, program = this.programs.of("screen.vert", "prefilter.frag", { LEVEL_0: Number(level === 0) });
      gl.bindTexture(gl.TEXTURE_2D, this.prefiltered);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.prefiltered, level);
      // None but the level that is read, which is its level 0 then: else reading and writing one texture would be refused.
      for (const name of [gl.TEXTURE_BASE_LEVEL, gl.TEXTURE_MAX_LEVEL]) gl.texParameteri(gl.TEXTURE_2D, name, Math.max(level - 1, 0));
      program.use({
        depth: 0.5, side, span: this.span, before: 0, lowest: map.coverage === "sphere" ? -1 : -laws.REACH * Math.sqrt(variance),
        spacing: Math.sqrt(Math.max((variance * 3) / 4 - texel ** 2 / 6, 0) / laws.HEXAGON_VARIANCE), source: level ? this.prefiltered : this.rest,
      });
      gl.bindVertexArray(this.drawing.empty);
      gl.viewport(0, 0, side, side);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.prefiltered);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_BASE_LEVEL, 0);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, laws.LEVELS - 1);
  }

  // Adds what lobes reflect of the map to the picture, whose frame is bound; values: of the surfaces, and lobe_visibility. mirrored: what they
  // show of the scene before it, if that is known.
  addReflected(values, mirrored) {
    const { gl, map } = this;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    this.drawing.fill(this.programs.of("screen.vert", "gloss.frag", this.constants), {
      ...values, weight: 1, scale: map.scale.map((value) => value * map.unit), base_variance: this.variance, prefiltered: this.prefiltered,
      albedo: this.albedo, mirrors: Number(Boolean(mirrored)), mirrored_scene: mirrored ?? this.drawing.white,
    });
    gl.disable(gl.BLEND);
  }

  // Draws the map behind the picture, whose frame is bound. matte: of shadow catchers, null where there are none.
  drawBehind(values, matte) {
    const { gl } = this, program = this.programs.of("screen.vert", "background.frag");
    const fill = (difference) => this.drawing.fill(program, { ...values, polar: this.polar, gain: this.map.unit, span: this.span, matte: matte ?? this.drawing.white, difference });
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    if (matte) fill(1);
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
    fill(0);
    gl.disable(gl.BLEND);
  }

  texture(smaller = this.gl.LINEAR) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, smaller);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    return texture;
  }
}
