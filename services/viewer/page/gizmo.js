// Handles over the picture, the server's and the browser's: an object or lamp is selected by a click, and moved, turned or scaled by a drag, or by
// keys while the picture has the focus. What is no handle's is left to the camera.

import { traceDiamond } from "/sky_geometry.js";

const MODULES = ["/gizmo_handles.js", "/relit_camera.js", "/scene_data.js"]; // what they need, once there is a scene
const REACH = { mouse: 9, touch: 22 }; // CSS pixels around a handle; 44 across for a finger
const AGAIN_MS = 2000; // as relit.js has it
const LEAST_DRAG = 4; // CSS pixels: less is a click
const NEAR_RADIUS = 9; // CSS pixels, of a near light's mark
const COLOURS = { x: "#ff6b60", y: "#6fd37c", z: "#6aa8ff", level: "#ffd08a", size: "#ffd08a" };
const KEYS = { q: "select", w: "move", e: "turn", r: "scale" }; // as editors of scenes have them
const STEPS = { // what an arrow is: an axis and a sign; page keys go up and down
  ArrowRight: ["x", 1], ArrowLeft: ["x", -1], ArrowUp: ["y", 1], ArrowDown: ["y", -1], PageUp: ["z", 1], PageDown: ["z", -1],
};

export class Gizmo {
  constructor(objects, view) {
    [this.objects, this.viewChosen] = [objects, view]; // view(): what was chosen, or nothing
    this.canvas = document.getElementById("gizmo");
    this.picture = document.getElementById("picture");
    this.tools = document.getElementById("gizmo-tools");
    this.tool = "select";
    this.scene = this.drag = this.hash = null;
    this.near = []; // near lights of the last summary
    this.with = {}; // the functions of MODULES
    for (const key of this.tools.querySelectorAll("[data-gizmo]")) key.addEventListener("click", () => this.use(key.dataset.gizmo));
    const stage = this.canvas.parentElement;
    stage.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    for (const kind of ["pointermove", "pointerup", "pointercancel"]) stage.addEventListener(kind, (event) => this.moveOrUp(event), { capture: true });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    objects.select.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  take(summary) {
    this.near = summary.near_lights;
    this.tools.hidden = Boolean(summary.why_no_controls) || !summary.objects.length;
    const hash = summary.scene?.hash || null;
    if (hash !== this.hash || !hash || performance.now() > this.again) this.load(hash, summary.scene?.text || "the renderer has not sent it");
    this.draw();
  }

  async load(hash, why) {
    [this.hash, this.again] = [hash, Infinity];
    let scene = null;
    try {
      if (hash) {
        this.with = Object.assign({}, ...(await Promise.all(MODULES.map((name) => import(name)))));
        scene = await this.with.loadScene();
      }
    } catch (error) {
      [why, this.again] = [error.message, performance.now() + AGAIN_MS];
    }
    if (hash !== this.hash) return; // another has come meanwhile
    this.scene = scene;
    this.canvas.parentElement.toggleAttribute("data-scene", Boolean(scene)); // fingers turn it; else they scroll the page
    for (const key of this.tools.querySelectorAll("button")) {
      const title = this.scene ? key.dataset.title : `No handles without the scene: ${why}`;
      key.disabled = !this.scene;
      if (key.title !== title) key.title = title;
    }
    this.draw();
  }

  use(tool) {
    this.tool = tool;
    this.canvas.parentElement.dataset.gizmo = tool; // a finger drags handles, and does not scroll
    for (const key of this.tools.querySelectorAll("[data-gizmo]")) key.setAttribute("aria-pressed", String(key.dataset.gizmo === tool));
    this.draw();
  }

  // The picture inside of the canvas, which it fits into, and from where it is seen; null where that is not known.
  get frame() {
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight], ratio = this.picture.width / this.picture.height;
    if (!this.scene || !w || !h || !ratio) return null;
    const width = Math.min(w, h * ratio), height = width / ratio;
    return { view: this.viewChosen() ?? this.scene.cameras[0], width, height, left: (w - width) / 2, top: (h - height) / 2 };
  }

  get pose() {
    return this.objects.poseNow();
  }

  get toolNow() {
    return this.tool === "scale" && this.pose?.power !== null ? "select" : this.tool; // lamps have no scale
  }

  place(event, frame) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left - frame.left, event.clientY - box.top - frame.top];
  }

  down(event) {
    const frame = this.frame;
    if (this.drag && this.drag.pointer !== event.pointerId) return this.downBeside(event);
    if (!frame || event.button || this.tools.hidden || !event.target.matches?.("canvas")) return;
    const at = this.place(event, frame), pose = this.pose, reach = event.pointerType === "touch" ? REACH.touch : REACH.mouse;
    const handle = pose ? this.with.handleAt(this.with.handlesOf(frame, this.toolNow, pose), at, reach) : null;
    this.drag = { frame, from: at, handle, pose, moved: false, tool: this.toolNow, pointer: event.pointerId };
    if (!handle) return; // the camera's drag, or a click
    event.stopPropagation();
    event.preventDefault();
    this.canvas.setPointerCapture(event.pointerId);
    this.draw();
  }

  // A second finger: two select nothing, and turn no camera while one of them holds a handle.
  downBeside(event) {
    this.drag.moved = true;
    if (this.drag.handle) event.stopPropagation();
  }

  moveOrUp(event) {
    const drag = this.drag;
    if (drag?.pointer !== event.pointerId) return;
    const at = this.place(event, drag.frame);
    drag.moved ||= Math.hypot(at[0] - drag.from[0], at[1] - drag.from[1]) >= LEAST_DRAG;
    if (drag.handle) {
      event.stopPropagation();
      if (drag.moved && event.type !== "pointercancel") this.objects.put(this.with.dragged(drag.frame, drag.tool, drag.handle, drag.pose, drag.from, at, event.ctrlKey));
    }
    if (event.type === "pointermove") return this.draw();
    this.drag = null;
    if (event.type === "pointerup" && !drag.handle && !drag.moved) this.selectAt(at, event.pointerType === "touch" ? REACH.touch : REACH.mouse);
    this.draw();
  }

  // The lamp, or else the object, at a place in the picture.
  selectAt(at, reach) {
    const frame = this.frame, places = this.lampPlaces(frame);
    const lamp = places.find(({ place }) => Math.hypot(place[0] - at[0], place[1] - at[1]) < Math.max(reach, 12));
    const found = lamp?.name ?? this.with.pick(this.scene, this.objects.posesNow(), this.with.rayThrough(frame.view, frame.width, frame.height, ...at))?.name;
    if (found) this.objects.selectObject(found);
    this.draw();
  }

  lampPlaces(frame) {
    const lamps = this.objects.posesNow().filter((pose) => pose.power !== null);
    return lamps.map((pose) => ({ name: pose.name, place: this.with.placeOf(frame, pose.position) })).filter(({ place }) => place);
  }

  key(event) {
    const tool = KEYS[event.key.toLowerCase()], step = STEPS[event.key], pose = this.pose;
    if (event.altKey || event.metaKey) return;
    if (tool && !event.ctrlKey) this.use(tool);
    else if (step && pose && this.toolNow !== "select") this.objects.put(this.stepped(pose, step, event.shiftKey ? 10 : 1));
    else return;
    event.preventDefault();
    event.stopPropagation();
    this.draw();
  }

  // One snap along, about, or larger; with Shift ten (turns: three).
  stepped(pose, [axis, sign], times) {
    const unit = ["x", "y", "z"].map((name) => (name === axis ? sign : 0));
    if (this.toolNow === "move") return { ...pose, position: this.with.moved(pose.position, unit.map((value) => value * this.with.SNAP.move * times)) };
    if (this.toolNow === "turn") return { ...pose, rotation: this.with.turned(pose.rotation, unit, this.with.SNAP.turn * (times > 1 ? 3 : 1)) };
    return this.with.scaled(pose, (1 + this.with.SNAP.scale) ** (sign * (times > 1 ? 5 : 1)), false);
  }

  draw() {
    const c = this.canvas.getContext("2d"), unit = devicePixelRatio, frame = this.frame;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.round(side * unit));
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, width, height);
    if (!frame) return;
    c.setTransform(unit, 0, 0, unit, frame.left * unit, frame.top * unit);
    [c.lineCap, c.lineJoin] = ["round", "round"];
    this.drawNear(c, frame);
    if (this.tools.hidden) return;
    const pose = this.pose;
    for (const { name, place: [x, y] } of this.lampPlaces(frame)) ring(c, x, y, 7, name === pose?.name ? "#ffd08a" : "#fff");
    if (!pose) return;
    const centre = this.with.placeOf(frame, pose.position);
    if (centre && pose.power === null) ring(c, ...centre, 4, "#ffd08a");
    for (const handle of this.with.handlesOf(frame, this.toolNow, pose)) drawHandle(c, handle, this.drag?.handle?.name === handle.name);
    this.canvas.dataset.selected = pose.name; // for tests
  }

  // A diamond where each near light is in the picture, as on the sky's disc, with its number and its distance from the rig.
  drawNear(c, frame) {
    c.font = "600 12px system-ui, sans-serif";
    const seen = this.near.map((light) => ({ light, place: this.with.placeOf(frame, light.at) })).filter(({ place }) => inside(place, frame));
    for (const { light, place: [x, y] } of seen) {
      traceDiamond(c, x, y, NEAR_RADIUS);
      outline(c, "#fff");
      const text = `${light.id} · ${light.distance_m.toFixed(2)} m`, left = x + NEAR_RADIUS + 4;
      [c.lineWidth, c.strokeStyle, c.fillStyle] = [3, "rgb(0 0 0 / 0.55)", "#fff"];
      c.strokeText(text, left, y + 4);
      c.fillText(text, left, y + 4);
    }
    this.canvas.dataset.near = seen.map(({ light }) => light.id).join(" "); // for tests
  }
}

function inside(place, { width, height }) {
  return place && place[0] >= 0 && place[0] <= width && place[1] >= 0 && place[1] <= height;
}

function drawHandle(c, { name, points }, held) {
  for (const [width, colour] of [[held ? 7 : 5, "rgb(0 0 0 / 0.55)"], [held ? 4 : 2.5, COLOURS[name]]]) {
    c.beginPath();
    for (const [x, y] of points) c.lineTo(x, y);
    [c.lineWidth, c.strokeStyle] = [width, colour];
    c.stroke();
  }
  const [x, y] = points.at(-1);
  if (name === "level" || points.length === 2) ring(c, x, y, name === "level" ? 6 : 4, COLOURS[name]);
}

function ring(c, x, y, radius, colour) {
  c.beginPath();
  c.arc(x, y, radius, 0, 2 * Math.PI);
  outline(c, colour);
}

// Strokes the path so that it shows on dark and on bright pictures.
function outline(c, colour) {
  [c.lineWidth, c.strokeStyle] = [4, "rgb(0 0 0 / 0.55)"];
  c.stroke();
  [c.lineWidth, c.strokeStyle] = [2, colour];
  c.stroke();
}
