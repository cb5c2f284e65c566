// The renderer's own shaders, in the browser's dialect, compiled when they are first wanted; the files and their text come with the scene.

const BLOCKS = ["MaterialBlock", "NearLights"]; // each at the binding of its number
// At the same places in all programs, so that a vertex array serves several.
const ATTRIBUTES = ["position", "normal", "uv", "vertex_colour", "second_uv", "alpha_uv", "vertex_alpha", "surfels", "surfel_weights"];

export class Programs {
  constructor(gl, shaders) {
    this.gl = gl;
    this.shaders = shaders;
    this.made = new Map();
  }

  // The program of two files in which each name stands for its value. Throws an Error with the compiler's first complaint.
  of(vertex, fragment, defines = {}) {
    const key = JSON.stringify([vertex, fragment, defines]);
    if (!this.made.has(key)) this.made.set(key, new Program(this.gl, [this.source(vertex, defines), this.source(fragment, defines)], `${vertex} + ${fragment}`));
    return this.made.get(key);
  }

  source(name, defines) {
    const lines = Object.entries(defines).map(([key, value]) => `#define ${key} ${value}\n`).join("");
    return this.shaders[name].replace("\n", `\n${lines}`);
  }
}

export class Program {
  constructor(gl, sources, name) {
    this.gl = gl;
    this.program = gl.createProgram();
    [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, k) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, sources[k]);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(`${name}: ${gl.getShaderInfoLog(shader).split("\n")[0]}`);
    });
    ATTRIBUTES.forEach((attribute, k) => gl.bindAttribLocation(this.program, k, attribute));
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(`${name}: ${gl.getProgramInfoLog(this.program).split("\n")[0]}`);
    this.uniforms = new Map();
    for (let k = 0; k < (gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS) ?? 0); k++) {
      const { name: uniform, type } = gl.getActiveUniform(this.program, k);
      this.uniforms.set(uniform, { type, at: gl.getUniformLocation(this.program, uniform) });
    }
    BLOCKS.forEach((name, k) => {
      const block = gl.getUniformBlockIndex(this.program, name);
      if (block !== gl.INVALID_INDEX && block !== null) gl.uniformBlockBinding(this.program, block, k);
    });
  }

  attribute(name) {
    return this.gl.getAttribLocation(this.program, name);
  }

  // Makes it current, with values by name; those that it does not use are passed over. A texture takes the next unit.
  use(values = {}) {
    const { gl } = this;
    gl.useProgram(this.program);
    let unit = 0;
    for (const [name, value] of Object.entries(values)) {
      const uniform = this.uniforms.get(name);
      if (!uniform) continue;
      if (uniform.type === gl.SAMPLER_2D) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, value);
        gl.uniform1i(uniform.at, unit++);
      } else if (uniform.type === gl.FLOAT) gl.uniform1f(uniform.at, value);
      else if (uniform.type === gl.FLOAT_VEC2) gl.uniform2fv(uniform.at, value);
      else if (uniform.type === gl.FLOAT_VEC3) gl.uniform3fv(uniform.at, value);
      else if (uniform.type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(uniform.at, false, value);
      else if (uniform.type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(uniform.at, false, value);
      else if (uniform.type === gl.UNSIGNED_INT) gl.uniform1ui(uniform.at, value);
      else gl.uniform1i(uniform.at, value);
    }
  }
}
