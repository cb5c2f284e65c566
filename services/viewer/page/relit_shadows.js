// The shadow maps of all lights in one depth texture, drawn by instancing: shadow_maps.py and casters.py in the browser.

import { mapHalvings, packed, writeFrame } from "/relit_lights.js";
import { boxCorners, boxOf, identity, transformed } from "/scene_data.js";

const MAX_ATLAS_SIDE = 4096; // texels: 64 MB of depth; where that is too little, maps are coarser. 2048 to 8192 would do
const LEAST_MAP = 16; // texels, as settings have it
const STILL = 0.25; // of a texel at the map's rim, by which a light may turn before its map is drawn again; 0.1 to 1 would do
const MARGIN = 0.1; // casters.py

export class Shadows {
  constructor(gl, scene, programs) {
    [this.gl, this.scene, this.programs] = [gl, scene, programs];
    const { casters, laws } = scene.description;
    this.casters = casters;
    this.laws = laws;
    this.maxSide = Math.min(MAX_ATLAS_SIDE, gl.getParameter(gl.MAX_TEXTURE_SIZE));
    this.boxes = scene.objects.map((mesh) => boxCorners(mesh.box));
    const positions = uploaded(gl, gl.ARRAY_BUFFER, scene.arrays.caster_positions);
    const indices = uploaded(gl, gl.ELEMENT_ARRAY_BUFFER, scene.arrays.caster_indices);
    this.drawers = [0, 1].map((plane) => {
      const program = programs.of("shadow.vert", "shadow.frag", { ALPHA_TEST: 0, RECEIVER_PLANE: plane });
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, positions);
      gl.enableVertexAttribArray(program.attribute("position"));
      gl.vertexAttribPointer(program.attribute("position"), 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
      return { program, array };
    });
    gl.bindVertexArray(null);
    this.frame = gl.createFramebuffer();
    this.frames = { texture: gl.createTexture(), rows: 0 };
    this.drawnFrames = { texture: gl.createTexture(), rows: 0 };
    this.halvings = new Map();
    this.kept = { key: "", directions: [] };
    this.width = this.height = 0;
  }

  // Draws the maps of these lights, points all of them, that are not as they should be. matrices: worldFromRest(). drawAlpha(first, count): draws
  // what is alpha-tested. Returns how many maps were drawn.
  draw(lights, matrices, drawAlpha) {
    const { laws } = this, box = this.place(matrices), count = lights.length;
    const halvings = mapHalvings(lights, laws, this.halvings);
    this.halvings = new Map(lights.map((light, k) => [light.id, halvings[k]]));
    const below = lights.map((light) => (this.plane ? light.direction.reduce((sum, value, k) => sum + value * this.casters.plane_normal[k], 0) < 0 : false));
    const order = Array.from(lights.keys()).sort((a, b) => halvings[a] - halvings[b] || below[a] - below[b] || lights[a].id - lights[b].id);
    let sizes, packing, coarser = -1;
    do { // where there is no room, all maps are halved
      coarser += 1;
      sizes = order.map((k) => Math.max(laws.LARGEST_MAP / 2 ** (halvings[k] + coarser), LEAST_MAP));
      packing = packed(sizes, this.maxSide);
    } while (!packing && sizes[0] > LEAST_MAP);
    if (!packing) throw new Error(`${count} lights have no room in the shadow maps that this browser can hold; ask for fewer`);
    [this.count, this.coarser] = [count, coarser];
    const key = `${order.map((k) => lights[k].id)} ${sizes} ${matrices.map((m) => m?.join() ?? "")}`;
    const known = key === this.kept.key, directions = [], redrawn = [];
    order.forEach((light, slot) => {
      const old = known ? this.kept.directions[slot] : null, now = lights[light].direction;
      const keeps = old && Math.hypot(...now.map((value, k) => value - old[k])) * sizes[slot] < STILL;
      directions.push(keeps ? old : now);
      if (!keeps) redrawn.push(slot);
    });
    this.kept = { key, directions };
    this.fit(packing.width, packing.height);
    const texels = laws.LIGHT_TEXELS, numbers = new Float32Array(4 * texels * this.count);
    order.forEach((light, slot) => {
      const map = { direction: directions[slot], resolution: sizes[slot], corner: packing.corners[slot], number: slot };
      writeFrame(numbers, 4 * texels * slot, lights[light], map, box, laws);
    });
    this.write(this.frames, numbers, this.count);
    if (redrawn.length) {
      const rows = new Float32Array(4 * texels * redrawn.length);
      redrawn.forEach((slot, k) => rows.set(numbers.subarray(4 * texels * slot, 4 * texels * (slot + 1)), 4 * texels * k));
      this.write(this.drawnFrames, rows, redrawn.length);
      this.redraw(redrawn, { sizes, packing, below: order.map((k) => below[k]), matrices, drawAlpha });
    }
    return redrawn.length;
  }

  redraw(redrawn, { sizes, packing, below, matrices, drawAlpha }) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.viewport(0, 0, this.width, this.height);
    gl.enable(gl.SCISSOR_TEST);
    for (const slot of redrawn) {
      gl.scissor(...packing.corners[slot], sizes[slot], sizes[slot]);
      gl.clear(gl.DEPTH_BUFFER_BIT);
    }
    gl.disable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.depthFunc(gl.LESS);
    gl.disable(gl.BLEND);
    const common = { lights_texture: this.drawnFrames.texture, atlas_texel: [1 / this.width, 1 / this.height] };
    for (let first = 0; first < redrawn.length;) {
      const size = sizes[redrawn[first]];
      let count = 1;
      while (first + count < redrawn.length && sizes[redrawn[first + count]] === size) count++;
      const level = this.casters.levels[Math.min(Math.round(Math.log2(this.laws.LARGEST_MAP / size)), this.casters.levels.length - 1)];
      const members = this.casters.members.map((member) => ({ mesh: member.mesh, detail: member.details[level] }));
      if (this.casters.receiver_plane && !this.plane) members.push({ mesh: this.casters.receiver_plane.mesh, detail: this.casters.receiver_plane.details[0] });
      for (const closed of [true, false]) {
        closed ? gl.enable(gl.CULL_FACE) : gl.disable(gl.CULL_FACE);
        this.instances(0, members.filter(({ detail }) => detail.closed === closed), matrices, { ...common, first_light: first }, count);
      }
      drawAlpha(common, first, count);
      const fromBelow = redrawn.slice(first, first + count).filter((slot) => below[slot]).length; // the last ones
      if (fromBelow && this.plane) {
        const plane = [{ mesh: this.plane.mesh, detail: this.plane.details[0] }];
        this.instances(1, plane, matrices, { ...common, first_light: first + count - fromBelow }, fromBelow);
      }
      first += count;
    }
  }

  instances(which, members, matrices, values, count) {
    const { gl } = this, { program, array } = this.drawers[which];
    gl.bindVertexArray(array);
    for (const { mesh, detail } of members) {
      if (!detail.indices.count) continue;
      program.use({ ...values, world_from_rest: matrices[mesh] ?? identity() });
      gl.drawElementsInstanced(gl.TRIANGLES, detail.indices.count, gl.UNSIGNED_INT, 4 * detail.indices.first, count);
    }
  }

  // Where the casters stand: the box around them, and the receiver plane, while nothing moved lies below it.
  place(matrices) {
    const { casters, scene } = this, plane = casters.receiver_plane;
    const moved = [...casters.members, ...(plane ? [plane] : [])].filter((caster) => matrices[caster.mesh]);
    const corners = (caster) => this.boxes[caster.mesh].map((corner) => transformed(matrices[caster.mesh], corner, 1));
    const pierced = moved.some((caster) => caster === plane || (plane && this.piercing(corners(caster))));
    this.plane = plane && !pierced ? plane : null;
    const which = this.plane ? 0 : 1;
    let [low, high] = [-1, 1].map((side) => casters.box_centre[which].map((value, k) => value + side * casters.box_half[which][k]));
    for (const caster of moved) {
      const own = boxOf(corners(caster).flat()), slack = 1e-5 * Math.max(...high.map((value, k) => value - low[k]));
      const more = low.map((value, k) => MARGIN * (Math.max(high[k], own[1][k]) - Math.min(value, own[0][k])));
      low = low.map((value, k) => (own[0][k] < value - slack ? own[0][k] - more[k] : value));
      high = high.map((value, k) => (own[1][k] > value + slack ? own[1][k] + more[k] : value));
    }
    return { centre: low.map((value, k) => (value + high[k]) / 2), half: low.map((value, k) => (high[k] - value) / 2) };
  }

  piercing(corners) {
    const { plane_normal: normal, receiver_plane: plane } = this.casters, on = this.scene.objects[plane.mesh].positions;
    const tolerance = 1e-4 * Math.hypot(...this.scene.description.half); // casters.SUNK
    return corners.some((corner) => corner.reduce((sum, value, k) => sum + (value - on[k]) * normal[k], 0) < -tolerance);
  }

  fit(width, height) {
    if (width === this.width && height === this.height) return;
    const { gl } = this;
    [this.width, this.height] = [width, height];
    gl.deleteTexture(this.texture ?? null);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, width, height);
    nearest(gl);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.texture, 0);
    this.kept = { key: "", directions: [] };
    checkErrors(gl);
  }

  // A row of texels for each light's frame.
  write(target, numbers, rows) {
    const { gl } = this, width = this.laws.LIGHT_TEXELS;
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    if (rows > target.rows || !target.rows) {
      target.rows = Math.max(64, 2 ** Math.ceil(Math.log2(Math.max(rows, 1))));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, target.rows, 0, gl.RGBA, gl.FLOAT, null);
      nearest(gl);
    }
    if (rows) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, rows, gl.RGBA, gl.FLOAT, numbers);
  }
}

export function nearest(gl) {
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
}

// Throws an Error where WebGL refused something since the last time.
export function checkErrors(gl) {
  const error = gl.getError();
  if (error !== gl.NO_ERROR && error !== gl.CONTEXT_LOST_WEBGL) {
    throw new Error(error === gl.OUT_OF_MEMORY ? "the graphics memory of this machine has no room for it" : `its WebGL refuses to draw the scene (error ${error})`);
  }
}

export function uploaded(gl, target, data) {
  const buffer = gl.createBuffer();
  if (target === gl.ELEMENT_ARRAY_BUFFER) gl.bindVertexArray(null); // whose own it would become
  gl.bindBuffer(target, buffer);
  gl.bufferData(target, data, gl.STATIC_DRAW);
  return buffer;
}
