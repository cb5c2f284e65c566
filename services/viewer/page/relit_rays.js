// The scene as rays in the browser's shaders meet it (scene_hits.glsl): its triangles in textures, in a balanced tree of boxes over them, which is made
// once, where things stand at rest; when something moves its boxes move along.

import { cross, dot, minus } from "/relit_camera.js";
import { checkErrors, nearest } from "/relit_shadows.js";
import { treeOrder } from "/relit_tree.js";
import { transformed } from "/scene_data.js";

const WIDTH_BITS = 11; // of the textures' rows: 2048 texels, which any WebGL2 has
const LEAF = 4; // triangles; 2 to 8 would do
const NOWHERE = 2 ** 100; // metres, where boxes without triangles lie
const ROW = 20; // numbers of a mesh: reflecting_rows.py

export class SceneRays {
  constructor(gl, scene) {
    [this.gl, this.scene] = [gl, scene];
    const { arrays, objects, description } = scene, vertices = arrays.positions.length / 3, triangles = arrays.indices.length / 3;
    this.leaves = 2 ** Math.ceil(Math.log2(Math.max(triangles / LEAF, 2)));
    this.triangles = this.rows(Math.max(3 * LEAF * this.leaves, 1));
    this.boxes = this.rows(4 * this.leaves);
    this.defines = { WIDTH_BITS, LEAF };
    this.places = arrays.positions.slice();
    this.corners = new Uint32Array(arrays.indices.length); // vertices of the whole scene
    const found = this.rows(2 * vertices), colours = arrays.colour_uvs ?? arrays.uvs, emissions = arrays.emission_uvs ?? arrays.uvs;
    description.meshes.forEach((mesh, k) => {
      for (let i = mesh.indices.first; i < mesh.indices.first + mesh.indices.count; i++) this.corners[i] = mesh.vertices.first + arrays.indices[i];
      for (let v = mesh.vertices.first; v < mesh.vertices.first + mesh.vertices.count; v++) {
        const own = arrays.colours ? arrays.colours.subarray(4 * v, 4 * v + 3) : [1, 1, 1];
        found.set([colours[2 * v], colours[2 * v + 1], emissions[2 * v], emissions[2 * v + 1], ...own, k], 8 * v);
      }
    });
    this.wind();
    this.order = treeOrder(middles(arrays.positions, this.corners), this.leaves, LEAF);
    this.mesh = (vertex) => found[8 * vertex + 7];
    this.holes = description.meshes.map((_, k) => arrays.reflecting[ROW * k + 11] > 0);
    this.moved = objects.map(() => "");
    this.textures = {
      ray_boxes: this.texture(gl.RGBA32F), ray_triangles: this.texture(gl.RGBA32F), ray_vertices: this.texture(gl.RGBA32F, found),
      ray_meshes: this.texture(gl.RGBA32F, padded(arrays.reflecting)), reflecting_texels: this.texture(gl.SRGB8_ALPHA8, padded(arrays.reflecting_texels)),
    };
    this.fresh = false;
    checkErrors(gl);
  }

  // Puts the triangles where they are now. matrices: worldFromRest().
  place(matrices) {
    const { arrays, description: { meshes } } = this.scene;
    meshes.forEach(({ vertices: { first, count } }, k) => {
      const now = matrices[k]?.join() ?? "";
      if (now === this.moved[k]) return;
      [this.moved[k], this.fresh] = [now, false];
      for (let v = first; v < first + count; v++) {
        const rest = arrays.positions.subarray(3 * v, 3 * v + 3);
        this.places.set(matrices[k] ? transformed(matrices[k], rest, 1) : rest, 3 * v);
      }
    });
    if (this.fresh) return false;
    this.fill();
    this.fresh = true;
    return true;
  }

  fill() {
    const { triangles, boxes, places, corners, leaves, order, holes } = this;
    boxes.fill(NOWHERE);
    for (let slot = 0; slot < order.length; slot++) {
      const box = 8 * (leaves + Math.floor(slot / LEAF)), has = holes[this.mesh(corners[3 * order[slot]])];
      for (let corner = 0; corner < 3; corner++) {
        const vertex = corners[3 * order[slot] + corner], at = 4 * (3 * slot + corner), first = boxes[box] === NOWHERE;
        for (let axis = 0; axis < 3; axis++) {
          const value = places[3 * vertex + axis];
          triangles[at + axis] = value;
          if (first || value < boxes[box + axis]) boxes[box + axis] = value;
          if (first || value > boxes[box + 4 + axis]) boxes[box + 4 + axis] = value;
        }
        triangles[at + 3] = has && corner === 0 ? -1 - vertex : vertex;
      }
    }
    for (let box = leaves - 1; box > 0; box--) {
      const [at, left, right] = [8 * box, 16 * box, 16 * box + 8];
      for (let axis = 0; axis < 3; axis++) {
        boxes[at + axis] = Math.min(boxes[left + axis], boxes[right + axis]);
        const [a, b] = [boxes[left + 4 + axis], boxes[right + 4 + axis]];
        boxes[at + 4 + axis] = b === NOWHERE ? a : Math.max(a, b); // those without triangles come last
      }
    }
    this.write(this.textures.ray_triangles, this.gl.RGBA32F, triangles);
    this.write(this.textures.ray_boxes, this.gl.RGBA32F, boxes);
  }

  // Winds the triangles so that their fronts are those of their vertices' normals.
  wind() {
    const { corners } = this, { positions, normals } = this.scene.arrays, at = (array, vertex) => array.subarray(3 * vertex, 3 * vertex + 3);
    for (let t = 0; t < corners.length; t += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => at(positions, corners[t + k])), facing = cross(minus([...b], a), minus([...c], a));
      const outwards = [0, 1, 2].reduce((sum, k) => sum + dot(facing, at(normals, corners[t + k])), 0);
      if (outwards < 0) [corners[t + 1], corners[t + 2]] = [corners[t + 2], corners[t + 1]];
    }
  }

  // A texture with up to four numbers for each vertex. numbersOf(vertex, mesh)
  perVertex(numbersOf) {
    const made = this.rows(this.scene.arrays.positions.length / 3);
    for (let vertex = 0; vertex < this.places.length / 3; vertex++) made.set(numbersOf(vertex, this.mesh(vertex)), 4 * vertex);
    return this.texture(this.gl.RGBA32F, made);
  }

  // What a program that follows rays needs.
  get values() {
    return { ...this.textures, first_leaf: this.leaves };
  }

  // Numbers for so many texels, in whole rows.
  rows(texels) {
    return new Float32Array(4 * (Math.ceil(texels / 2 ** WIDTH_BITS) << WIDTH_BITS));
  }

  texture(format, numbers) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    nearest(gl);
    if (numbers) this.write(texture, format, numbers);
    return texture;
  }

  write(texture, format, numbers) {
    const { gl } = this, width = 2 ** WIDTH_BITS;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, width, numbers.length / (4 * width), 0, gl.RGBA, format === gl.RGBA32F ? gl.FLOAT : gl.UNSIGNED_BYTE, numbers);
  }
}

function middles(positions, corners) {
  const made = new Float32Array(corners.length);
  for (let t = 0; t < corners.length; t += 3) {
    for (let axis = 0; axis < 3; axis++) made[t + axis] = (positions[3 * corners[t] + axis] + positions[3 * corners[t + 1] + axis] + positions[3 * corners[t + 2] + axis]) / 3;
  }
  return made;
}

// The numbers in whole rows, at least one.
function padded(numbers) {
  const row = 4 << WIDTH_BITS, made = new numbers.constructor(Math.max(Math.ceil(numbers.length / row), 1) * row);
  made.set(numbers);
  return made;
}
