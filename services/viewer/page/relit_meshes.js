// The scene's meshes on the GPU: their vertices, materials and textures, and the programs that draw them.

import { uploaded } from "/relit_shadows.js";

const VERTEX = { position: ["positions", 3], normal: ["normals", 3], uv: ["uvs", 2], vertex_colour: ["colours", 4], second_uv: ["second_uvs", 2] };

export class Meshes {
  // surfels: whether vertices say among which they lie.
  constructor(gl, scene, programs, surfels) {
    Object.assign(this, { gl, scene, programs, surfels });
    const { description } = scene;
    this.white = this.texture({ width: 1, height: 1, srgb: false, repeats: [true, true], filters: [gl.NEAREST, gl.NEAREST] }, new Uint8Array([255, 255, 255, 255]));
    this.textures = description.textures.map((texture) => this.texture(texture, new Uint8Array(scene.buffer, texture.texels.offset, texture.texels.count)));
    this.materials = description.materials.map((material) => ({ ...material, block: uploaded(gl, gl.UNIFORM_BUFFER, new Float32Array(material.row)) }));
    this.buffers = Object.fromEntries(Object.entries(VERTEX).map(([, [name]]) => [name, scene.arrays[name] && uploaded(gl, gl.ARRAY_BUFFER, scene.arrays[name])]));
    if (surfels) this.betweens = ["vertex_surfels", "surfel_weights"].map((name) => uploaded(gl, gl.ARRAY_BUFFER, scene.arrays[name]));
    this.indices = uploaded(gl, gl.ELEMENT_ARRAY_BUFFER, scene.arrays.indices);
    this.items = description.meshes.map((mesh, k) => this.item(mesh, k));
    this.kinds = [...new Set(description.materials.map((material) => material.kind))].sort();
  }

  item(mesh, number) {
    const material = this.materials[mesh.material], { variant } = material;
    const program = this.programs.of("surface.vert", "surface.frag", this.surfels ? { ...variant, SURFELS: 1 } : variant);
    return { material, program, back: mesh.back, array: this.vertices(program, mesh), indices: mesh.indices, caster: material.cutoff === null ? null : this.alphaCaster(mesh, number) };
  }

  // An alpha-tested mesh as shadow maps draw it: alpha_test.py.
  alphaCaster(mesh, number) {
    const { gl } = this, { objects } = this.scene, material = this.materials[mesh.material];
    const program = this.programs.of("shadow.vert", "shadow_alpha_test.frag", { ALPHA_TEST: 1, RECEIVER_PLANE: 0 });
    const alpha = material.textures[0], { count, first } = mesh.vertices, object = objects[number];
    const colours = this.scene.arrays.colours, vertexAlpha = new Float32Array(count);
    for (let k = 0; k < count; k++) vertexAlpha[k] = material.alpha * (colours ? colours[4 * (first + k) + 3] : 1);
    const uvs = material.alpha_uv_set && this.scene.arrays.second_uvs ? this.scene.arrays.second_uvs : this.scene.arrays.uvs;
    const [[a, b, c], [d, e, f]] = material.alpha_uv_transform, placed = new Float32Array(2 * count);
    for (let k = 0; k < count; k++) {
      const u = uvs[2 * (first + k)], v = uvs[2 * (first + k) + 1];
      placed.set([a * u + b * v + c, d * u + e * v + f], 2 * k);
    }
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [name, data, numbers] of [["position", object.positions, 3], ["alpha_uv", placed, 2], ["vertex_alpha", vertexAlpha, 1]]) {
      uploaded(gl, gl.ARRAY_BUFFER, data);
      const at = program.attribute(name);
      if (at < 0) continue;
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, numbers, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    return { program, array, texture: alpha === null ? this.white : this.alphaTexture(alpha) };
  }

  // The fourth channel of a texture as its first.
  alphaTexture(number) {
    const texture = this.scene.description.textures[number];
    const texels = new Uint8Array(this.scene.buffer, texture.texels.offset, texture.texels.count), alphas = new Uint8Array(texels.length);
    for (let k = 0; k < texels.length; k++) alphas[k] = texels[k | 3];
    return this.texture({ ...texture, srgb: false }, alphas);
  }

  vertices(program, mesh) {
    const { gl } = this, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [name, [source, numbers]] of Object.entries(VERTEX)) {
      const at = program.attribute(name);
      if (at < 0) continue;
      if (!this.buffers[source]) {
        gl.disableVertexAttribArray(at);
        gl.vertexAttrib4f(at, 1, 1, 1, 1); // of the context, not of the array: all that lack it are white
        continue;
      }
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[source]);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, numbers, gl.FLOAT, false, 0, 4 * numbers * mesh.vertices.first);
    }
    if (this.surfels) this.betweenSurfels(program, mesh.vertices.first);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    return array;
  }

  // Among which surfels the vertices lie, in the vertex array that is bound.
  betweenSurfels(program, first) {
    const { gl } = this;
    for (const [k, name, kind, normalised, bytes] of [[0, "surfels", gl.UNSIGNED_SHORT, false, 8], [1, "surfel_weights", gl.UNSIGNED_BYTE, true, 4]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.betweens[k]);
      gl.enableVertexAttribArray(program.attribute(name));
      gl.vertexAttribPointer(program.attribute(name), 4, kind, normalised, bytes, bytes * first);
    }
  }

  texture({ width, height, srgb, repeats, filters }, texels) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, srgb ? gl.SRGB8_ALPHA8 : gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filters[0]);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filters[1]);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, repeats[0] ? gl.REPEAT : gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, repeats[1] ? gl.REPEAT : gl.CLAMP_TO_EDGE);
    return texture;
  }
}
