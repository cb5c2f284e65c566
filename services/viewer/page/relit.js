// The picture that this browser draws, beside the server's: the scene comes once, then lights and poses alone. One of three is shown: the server's
// picture, the browser's, or both with a line between that a slider moves. The camera that is turned here turns the server's, too.

import { loadScene } from "/scene_data.js";
import { RelitHands } from "/relit_hands.js";
import { contextOf, SceneDrawing } from "/relit_draw.js";
import { environmentFromBytes } from "/relit_environment.js";

const WINDOW_MS = 1000; // over which frames and bytes are counted
// What a picture is made of, from all to the least. One that takes longer than SLOW_MS goes down, one that takes less than FAST_MS up again: software
// draws 640 x 480 pixels under 72 lights in about a second. Between them a factor of 4 and some, which the pixels cost; light from surface to surface
// costs about 2. shrunk: by which width and height are smaller than the server's.
const SLOW_MS = 200, FAST_MS = 35;
const LEVELS = [{ shrunk: 1, bounces: true }, { shrunk: 1, bounces: false }, { shrunk: 2, bounces: false }, { shrunk: 4, bounces: false }];
const AGAIN_MS = 2000; // after a scene that did not come, until it is asked for again. 1 to 10 s would do
const at = (id) => document.getElementById(id);

export class Relit {
  // control(): what was chosen; chosenPoses(): of objects; choose: makes a choice.
  // onMode: called when another picture may be looked at.
  constructor(control, chosenPoses, choose) {
    [this.control, this.chosenPoses, this.choose] = [control, chosenPoses, choose];
    [this.canvas, this.slider, this.line, this.presets] = ["relit", "relit-slider", "relit-line", "relit-camera"].map(at);
    this.mode = "server";
    this.scene = this.drawing = this.frame = this.own = this.environment = null;
    this.hash = undefined;
    this.why = "the renderer has not sent the scene";
    this.state = { tone: null, objects: [] };
    this.counted = []; // of the last second: [when, frames, bytes]
    this.dirty = this.waiting = false;
    this.level = 0; // of LEVELS
    this.onMode = () => {};
    for (const key of document.querySelectorAll("[data-relit]")) key.addEventListener("click", () => this.show(key.dataset.relit));
    this.slider.addEventListener("input", () => this.split());
    this.heedDivider(at("relit-divider"));
    this.presets.addEventListener("change", () => this.takePreset());
    at("relit-full").addEventListener("click", () => this.toggleFull());
    this.heed(this.canvas);
    this.hands = new RelitHands(this);
    this.showKeys();
    setInterval(() => this.showLine(), WINDOW_MS);
  }

  // Whether the server's picture is not looked at.
  get alone() {
    return this.mode === "browser" && this.draws;
  }

  get draws() {
    return this.mode !== "server" && Boolean(this.drawing) && !this.lost;
  }

  // From where the scene is seen; null before it is there. own: where the server takes no choices.
  get view() {
    return (this.locked ? this.own : this.control().camera) ?? this.scene?.cameras[0] ?? null;
  }

  turn({ from, at: aim, fov_y }) {
    if (this.locked) this.own = { from, at: aim, fov_y };
    else this.choose({ camera: { from, at: aim, fov_y } });
    this.redraw();
  }

  take(summary) {
    this.locked = Boolean(summary.why_no_controls);
    const hash = summary.scene?.hash || null;
    if (hash !== this.hash || performance.now() > this.again) this.load(hash, summary.scene?.text);
    this.showPreset();
    this.redraw();
  }

  async load(hash, why) {
    [this.hash, this.again] = [hash, Infinity];
    this.free();
    [this.scene, this.why] = [null, why || "the renderer has not sent the scene"];
    this.showKeys();
    let scene = null, failure = "";
    try {
      if (hash) scene = await loadScene();
    } catch (error) {
      failure = error.message;
    }
    if (hash !== this.hash) return; // another has come meanwhile
    if (failure) [this.why, this.again] = [failure, performance.now() + AGAIN_MS];
    this.scene = scene;
    this.presets.replaceChildren(...(this.scene?.cameras ?? []).map(({ name }, k) => new Option(k ? name : `${name} (Home)`, k)), ...(this.scene ? [new Option("turned", "")] : []));
    this.showPreset();
    this.build();
  }

  // Puts the scene on the GPU, when somebody wants to see it.
  build() {
    this.free();
    if (this.scene && this.mode !== "server") {
      try {
        const { gl, why } = contextOf(this.canvas);
        [this.gl, this.why] = [gl, why ?? ""];
        if (!why) this.drawing = new SceneDrawing(gl, this.scene);
        this.drawing?.environment.take(this.environment);
      } catch (error) {
        this.why = error.message;
      }
    }
    this.showKeys();
    this.redraw();
  }

  // Frees what is on the GPU. A canvas has one context, which goes with it.
  free() {
    this.drawing = null;
    if (!this.gl) return;
    const fresh = this.canvas.cloneNode(), { gl } = this;
    this.canvas.replaceWith(fresh);
    [this.canvas, this.gl, this.lost] = [fresh, null, false];
    this.heed(fresh);
    gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  // The line itself is dragged, too; keys have the slider.
  heedDivider(divider) {
    divider.addEventListener("pointerdown", (event) => { divider.setPointerCapture(event.pointerId); event.stopPropagation(); });
    divider.addEventListener("pointermove", (event) => {
      if (!divider.hasPointerCapture(event.pointerId)) return;
      const { left, width } = divider.parentElement.getBoundingClientRect();
      this.slider.value = String((100 * (event.clientX - left)) / width);
      this.split();
    });
  }

  heed(canvas) {
    canvas.addEventListener("webglcontextlost", (event) => {
      if (canvas !== this.canvas) return;
      event.preventDefault(); // or it would never be restored
      this.lost = true;
      this.showKeys();
    });
    canvas.addEventListener("webglcontextrestored", () => { if (canvas === this.canvas) this.build(); });
  }

  show(mode) {
    this.mode = mode;
    if (!this.drawing && mode !== "server") this.build();
    this.showKeys();
    this.redraw();
  }

  showKeys() {
    for (const key of document.querySelectorAll("[data-relit]")) key.setAttribute("aria-pressed", String(key.dataset.relit === this.mode));
    this.canvas.hidden = !this.draws;
    this.slider.hidden = at("relit-divider").hidden = !(this.draws && this.mode === "split");
    this.canvas.dataset.mode = this.mode;
    this.presets.hidden = at("relit-full").hidden = !this.scene;
    this.split();
    this.showLine();
    this.onMode();
  }

  split() {
    const share = this.mode === "split" ? Number(this.slider.value) : 0;
    this.canvas.style.clipPath = share ? `inset(0 0 0 ${share}%)` : "";
    at("relit-divider").style.left = `${share}%`;
  }

  home() {
    this.presets.value = "0";
    this.takePreset();
  }

  takePreset() {
    const number = this.presets.value;
    if (number === "0") this.locked ? (this.own = null) : this.choose({ camera: null });
    else if (number) return this.turn(this.scene.cameras[Number(number)]);
    this.redraw();
  }

  showPreset() {
    if (!this.scene || document.activeElement === this.presets) return;
    const now = JSON.stringify(numbersOf(this.view)), found = this.scene.cameras.findIndex((camera) => JSON.stringify(numbersOf(camera)) === now);
    this.presets.value = found < 0 ? "" : String(found);
  }

  toggleFull() {
    document.fullscreenElement ? document.exitFullscreen() : at("scene").requestFullscreen?.();
  }

  // A frame of lightsFromBytes(), and how many bytes it had.
  takeLights(frame, bytes) {
    this.frame = frame;
    this.count(0, bytes);
    this.redraw();
  }

  // The map behind the lights, as the feed environment.bin has it.
  async takeEnvironment(buffer) {
    this.environment = await environmentFromBytes(buffer);
    this.drawing?.environment.take(this.environment);
    this.count(0, buffer.byteLength);
    this.redraw();
  }

  // How the server's newest picture was made (feed picture-state), and how many bytes say so.
  takeState(state, bytes) {
    this.state = state;
    this.count(0, bytes);
    this.redraw();
  }

  // Objects as the server's picture has them, and as they were chosen here since.
  poses() {
    const chosen = new Map(this.chosenPoses().map((pose) => [pose.name, pose]));
    return this.scene.description.objects.map((rest, k) => {
      const [x, y, z, qx, qy, qz, qw, scale] = this.state.objects[k] ?? [];
      const now = scale === undefined ? rest : { ...rest, position: [x, y, z], rotation: [qx, qy, qz, qw], scale };
      return { ...now, ...chosen.get(rest.name) };
    });
  }

  redraw() {
    this.dirty = true;
    if (this.waiting || this.mode === "server" || !this.drawing) return;
    this.waiting = true;
    requestAnimationFrame(async () => {
      const { drawing } = this, began = performance.now(), drawn = this.draw();
      if (drawn) await drawing.finished(); // else pictures would queue, and the page stand still
      if (drawn) this.fit(performance.now() - began);
      this.waiting = false;
      if (drawn && !this.drawn.settled) this.dirty = true;
      if (this.dirty) this.redraw();
    });
  }

  // As much as there is time for. The first picture after a change of the size makes its textures.
  fit(ms) {
    const wanted = ms > SLOW_MS ? Math.min(this.level + 1, LEVELS.length - 1) : ms < FAST_MS ? Math.max(this.level - 1, 0) : this.level;
    if (wanted === this.level) this.changes = 0;
    else if ((this.changes = (this.changes ?? 0) + 1) > 1) [this.level, this.changes] = [wanted, -1];
  }

  // Whether there was something to draw.
  draw() {
    this.dirty = false;
    if (!this.drawing || !this.frame || this.lost) return false;
    try {
      const { shrunk, bounces } = LEVELS[this.level], { directional, near } = this.frame;
      const [width, height] = this.scene.description.size.map((side) => Math.max(Math.round(side / shrunk), 1));
      this.drawn = this.drawing.draw({ view: this.view, lights: directional, near, poses: this.poses(), tone: this.state.tone, width, height, bounces });
    } catch (error) {
      if (this.gl.isContextLost()) return false; // which the canvas is told of soon
      this.free();
      this.why = error.message;
      this.showKeys();
      return false;
    }
    this.count(1, 0);
    Object.assign(this.canvas.dataset, { shown: Number(this.canvas.dataset.shown ?? 0) + 1, sequence: this.frame.sequence }); // for tests
    return true;
  }

  count(frames, bytes) {
    this.counted.push([performance.now(), frames, bytes]);
  }

  showLine() {
    const since = performance.now() - WINDOW_MS;
    this.counted = this.counted.filter(([when]) => when >= since);
    const sum = (k) => this.counted.reduce((total, entry) => total + entry[k], 0), [frames, bytes] = [sum(1), sum(2)];
    Object.assign(this.line.dataset, { frames, bytes });
    const text = this.mode === "server" ? "" : this.words(frames, bytes);
    if (this.line.textContent !== text) this.line.textContent = text;
  }

  words(frames, bytes) {
    if (this.lost) return "The graphics driver of this machine has taken the picture away; it comes back as soon as the driver is ready.";
    if (!this.drawing) return `Not drawn in this browser: ${this.why}.`;
    if (!this.frame) return "Waiting for lights …";
    const { lights = 0, near = 0, left: weaker = 0, coarser = 0, settled = true } = this.drawn ?? {}, { shrunk, bounces } = LEVELS[this.level];
    const late = this.drawing.bounce && !bounces ? ["light from surface to surface, for which this machine has no time"] : [];
    const without = [...this.scene.description.left_out, ...this.drawing.missing, ...late];
    const all = `${lights} lights${near ? `, ${near} of them near` : ""}${weaker ? ` (${weaker} weaker ones are left out)` : ""}`;
    const coarse = coarser ? ` Shadow maps are ${2 ** coarser} times coarser than the settings', for which this browser has no room.` : "";
    const small = shrunk > 1 ? ` It has 1/${shrunk ** 2} of the server's pixels, as many as this machine draws in time.` : "";
    const left = without.length ? ` Without ${without.join(", ")}.` : "";
    const found = settled ? "" : " Light from surface to surface is still being found.";
    return `This browser draws ${frames ? `${frames} picture${frames > 1 ? "s" : ""}` : "less than one picture"} a second under ${all}, from ${(bytes / 1000).toFixed(1)} kB a second.${small}${coarse}${left}${found}`;
  }
}

function numbersOf({ from, at: aim, fov_y }) {
  return [...from, ...aim, fov_y].map((value) => Number(value.toFixed(6)));
}
