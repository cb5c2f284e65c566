// Near lights in the browser: shadow maps through the six faces of a cube about each, in one depth texture, and the sum over them for each pixel. The
// laws and shaders are the renderer's: near_light_views.py, near_light_plan.py, near_lights.py.

import { nearestDistance } from "/relit_camera.js";
import { checkErrors, nearest, uploaded } from "/relit_shadows.js";
import { boxCorners, identity } from "/scene_data.js";

const FACES = 6, CORNERS = 8;
const AXES = [[0, 1, 2], [0, 1, 2], [1, 2, 0], [1, 2, 0], [2, 0, 1], [2, 0, 1]]; // x, y and depth of each face's view; every second one looks back
const EDGES = [1, 2, 4].flatMap((bit) => Array.from({ length: CORNERS }, (_, k) => [k, k | bit]).filter(([a, b]) => a !== b)); // of boxCorners()
const MAX_SIDE = 4096; // texels of the texture: 64 MB of depth; maps of up to 10 lights then have the server's resolution, of more at least half of it
const NEAR_BINDING = 1; // relit_programs.js

export class NearLights {
  // drawing: a SceneDrawing, with its materials on the GPU.
  constructor(drawing) {
    const { gl, scene, laws, programs, items } = drawing;
    Object.assign(this, { drawing, gl, laws, programs, items });
    this.boxes = scene.objects.map((mesh) => mesh.box);
    this.maxSide = Math.min(MAX_SIDE, gl.getParameter(gl.MAX_TEXTURE_SIZE));
    this.kept = []; // of each slot the light whose maps it holds, as it was when they were drawn: { id, at, radius }; null: none
    this.lights = [];
    this.key = null;
  }

  // Draws those maps of these lights that are not as they should be. boxes: of the meshes, [low, high], where they are now. Returns how many lights' maps
  // were drawn.
  drawMaps(lights, matrices, boxes) {
    this.lights = lights.filter(({ intensity }) => intensity.some((value) => value > 0)).slice(0, this.laws.NEAR_BATCH);
    if (!this.lights.length) return 0;
    this.fit(this.lights.length);
    const key = matrices.map((m) => m?.join() ?? "").join(" ");
    if (key !== this.key) [this.key, this.kept] = [key, this.kept.map(() => null)];
    const reach = (at) => Math.hypot(...at.map((value, k) => Math.max(Math.min(...boxes.map(([low]) => low[k])) - value, value - Math.max(...boxes.map(([, high]) => high[k])), 0)));
    const stale = this.placed().filter(({ slot, light }) => !this.serves(this.kept[slot], light, reach));
    if (stale.length) this.redraw(stale, matrices, boxes);
    this.writeLights();
    return stale.length;
  }

  // Each light and its slot: the one that it has, or a free one.
  placed() {
    const wanted = new Set(this.lights.map(({ id }) => id)), slots = new Map(this.kept.map((kept, slot) => [kept?.id, slot]));
    const free = this.kept.flatMap((kept, slot) => (kept && wanted.has(kept.id) ? [] : [slot]));
    this.slots = this.lights.map(({ id }) => slots.get(id) ?? free.pop());
    return this.lights.map((light, k) => ({ light, slot: this.slots[k] }));
  }

  // Whether maps drawn for a light as it was do for it as it is: near_in_time.
  serves(kept, light, reach) {
    if (kept?.id !== light.id) return false;
    const { KEPT_RAD, KEPT_RADIUS } = this.laws, moved = Math.hypot(...light.at.map((value, k) => value - kept.at[k]));
    return moved <= Math.max(KEPT_RAD * reach(light.at), KEPT_RADIUS * kept.radius) && Math.abs(light.radius - kept.radius) <= Math.max(KEPT_RADIUS * kept.radius, 1e-3);
  }

  redraw(stale, matrices, boxes) {
    const { gl, laws, side, columns } = this, texels = laws.NEAR_VIEW_TEXELS, drawn = [];
    for (const { light, slot } of stale) {
      const views = shadowViews(light, boxes, side, laws);
      views.forEach((view, face) => {
        const tile = FACES * slot + face, corner = [(tile % columns) * side, Math.floor(tile / columns) * side];
        const at = 4 * texels * tile, put = (name, values) => this.views.set(values, at + laws[`NEAR_VIEW_AT_${name}`]);
        Object.entries({ ...view.row, face: [face], corner }).forEach(([name, values]) => put(name, values));
        if (view.meshes.length) drawn.push({ tile, corner, meshes: view.meshes });
      });
      this.kept[slot] = { id: light.id, at: light.at, radius: light.radius };
    }
    gl.bindTexture(gl.TEXTURE_2D, this.viewsTexture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, texels, FACES * this.kept.length, gl.RGBA, gl.FLOAT, this.views);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.viewport(0, 0, this.width, this.height);
    gl.enable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.depthFunc(gl.LESS);
    gl.disable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    for (const each of drawn) this.drawTile(each, matrices);
    gl.disable(gl.SCISSOR_TEST);
  }

  drawTile({ tile, corner, meshes }, matrices) {
    const { gl, side } = this, common = { drawn_views_texture: this.viewsTexture, first_view: tile, map_size: side, atlas_size: [this.width, this.height] };
    gl.scissor(...corner, side, side);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    for (const k of meshes) {
      const { caster, array, material, indices } = this.items[k];
      const program = caster ? this.programs.of("near_light_map.vert", "shadow_alpha_test.frag", { ALPHA_TEST: 1, NEAR_LIGHT: 1 }) : this.programs.of("near_light_map.vert", "near_light_map.frag", { ALPHA_TEST: 0 });
      gl.bindVertexArray(caster ? caster.array : array);
      program.use({ ...common, world_from_rest: matrices[k] ?? identity(), ...(caster && { alpha_cutoff: material.cutoff, alpha_texture: caster.texture }) });
      gl.drawElements(gl.TRIANGLES, indices.count, gl.UNSIGNED_INT, 4 * indices.first);
    }
  }

  writeLights() {
    const { gl, laws, lights } = this, numbers = new Float32Array(4 * laws.NEAR_TEXELS * lights.length);
    lights.forEach((light, k) => {
      const put = (name, values) => numbers.set(values, 4 * laws.NEAR_TEXELS * k + laws[`NEAR_AT_${name}`]);
      put("at", light.at);
      put("radius", [light.radius]);
      put("intensity", light.intensity);
      put("layer", [this.slots[k]]);
    });
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.block);
    gl.bufferSubData(gl.UNIFORM_BUFFER, 0, numbers);
  }

  // Adds their light to surfaces of these kinds, in the frame that is bound; values: of the surfaces. Catchers are left to the server.
  add(values, kinds, defines = {}, area) {
    const { gl } = this;
    if (!this.lights.length) return;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.bindBufferBase(gl.UNIFORM_BUFFER, NEAR_BINDING, this.block);
    for (const kind of kinds) {
      this.drawing.fill(this.programs.of("screen.vert", "near_lights.frag", { KIND: kind, TRACED: 0, ...defines }), {
        ...values, near_maps: this.texture, near_views_texture: this.viewsTexture, map_size: this.side, light_count: this.lights.length, weight: 1,
      }, area);
    }
    gl.disable(gl.BLEND);
  }

  // Has room for the maps of so many lights, and not for four times as many or more.
  fit(count) {
    if (count <= this.kept.length && 4 * count > this.kept.length) return;
    const { gl, laws } = this, texels = laws.NEAR_VIEW_TEXELS, slots = 2 ** Math.ceil(Math.log2(count));
    this.free();
    this.kept = Array(slots).fill(null);
    this.side = Math.min(2 ** Math.floor(Math.log2(this.maxSide / Math.sqrt(FACES * slots))), laws.BY_POWER ? laws.MAX_RESOLUTION : laws.LARGEST_MAP);
    this.columns = Math.ceil(Math.sqrt(FACES * slots));
    [this.width, this.height] = [this.columns * this.side, Math.ceil((FACES * slots) / this.columns) * this.side];
    this.views = new Float32Array(4 * texels * FACES * slots);
    this.block = uploaded(gl, gl.UNIFORM_BUFFER, new Float32Array(4 * laws.NEAR_TEXELS * laws.NEAR_BATCH));
    this.viewsTexture = this.storage(gl.RGBA32F, texels, FACES * slots);
    this.texture = this.storage(gl.DEPTH_COMPONENT24, this.width, this.height);
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.texture, 0);
    checkErrors(gl);
  }

  storage(format, width, height) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    nearest(gl);
    return texture;
  }

  free() {
    const { gl } = this;
    for (const texture of [this.texture, this.viewsTexture]) gl.deleteTexture(texture ?? null);
    gl.deleteFramebuffer(this.frame ?? null);
    gl.deleteBuffer(this.block ?? null);
  }
}

// The views of a light's six maps: `row`, what the shaders read but the face and its corner, and which meshes each sees: shadow_views.
export function shadowViews({ at, radius }, boxes, side, laws) {
  const corners = boxes.map((box) => boxCorners(box).map((corner) => corner.map((value, k) => value - at[k])));
  const farthest = corners.map((all) => Math.max(...all.map((corner) => Math.hypot(...corner)))), far = Math.max(...farthest) * laws.FAR_MARGIN;
  const typical = [...farthest].sort((a, b) => a - b)[Math.floor(laws.QUARTER * (boxes.length - 1))];
  const near = Math.min(Math.max(laws.NEAR_FRACTION * typical, radius / 2, nearestDistance(at, boxes) / 2), far / 2);
  const least = 1e-6 * Math.max(...farthest, 1e-9);
  return AXES.map((axes, face) => {
    const seen = corners.map((all) => faceWindow(all, axes, face % 2 ? -1 : 1, least, laws.CUBE_TANGENT)), met = seen.filter(Boolean);
    const low = [0, 1].map((k) => Math.min(...met.map((window) => window.low[k]))), high = [0, 1].map((k) => Math.max(...met.map((window) => window.high[k])));
    const edge = low.map((value, k) => (met.length ? (laws.EDGE_TEXELS / side) * (high[k] - value) : 0));
    const row = met.length ? { low: low.map((value, k) => value - edge[k]), high: high.map((value, k) => value + edge[k]) } : { low: [0, 0], high: [-1, -1] };
    return { row: { ...row, origin: at, inverse_depths: [1 / near, 1 / far], radius: [radius] }, meshes: seen.flatMap((window, k) => (window ? [k] : [])) };
  });
}

// The window of tangents in which a face sees a box of these corners about the light, each edge as far as it lies before it; null where it sees none.
function faceWindow(corners, [x, y, z], sign, least, most) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const [a, b] of EDGES) {
    for (const [own, other] of [[corners[a], corners[b]], [corners[b], corners[a]]]) {
      const depth = sign * own[z], beyond = sign * other[z];
      if (depth <= least && beyond <= least) continue;
      const part = depth > least ? 0 : (least - depth) / (beyond - depth);
      [x, y].forEach((axis, k) => {
        const tangent = (own[axis] + part * (other[axis] - own[axis])) / Math.max(depth, least);
        low[k] = Math.min(low[k], tangent);
        high[k] = Math.max(high[k], tangent);
      });
    }
  }
  const inside = [0, 1].map((k) => [Math.max(low[k], -most), Math.min(high[k], most)]);
  return inside.every(([from, to]) => from < to) ? { low: inside.map(([from]) => from), high: inside.map(([, to]) => to) } : null;
}
