// Masks and virtual lamps on the sky: drawn and dragged with the pointer, or by keys with a cross that the arrows move.

import { MAX_LAMPS, MAX_LAMP_ID, MAX_MASKS, MAX_MASK_POINTS, MAX_POINTS } from "/constants.js";
import { directionFrom, distanceTo, hundredths, isInside, placeFrom, simplified, spanOf } from "/sky_geometry.js";
import { drawTools } from "/sky_overlay.js";
import { SkyItems } from "/sky_items.js";
import { SkyValues } from "/sky_values.js";

const HOLD_MS = 1200; // after an input the server's summary may still be older than the input; any value in 600..3000 does
const RIM = 19; // CSS pixels outside of the disc, where the compass is (sky.js)
const REACH = 14; // CSS pixels around a handle within which the pointer takes it
const BRUSH_SPACING = 0.004; // of the radius: a third of a degree; strokes are simplified to that
const LEAST_DRAG = 3; // CSS pixels: less is a click
const LAMP_DEG = 10; // across, of a lamp that is put down without a drag
const MAX_LAMP_DEG = 120; // as the wire has it
const STEP_DEG = 2, WIDE_STEP_DEG = 10; // of the cross, with Shift the second
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class SkyTools {
  constructor(sky, choose, notice) {
    [this.sky, this.choose, this.notice] = [sky, choose, notice];
    this.masks = [];
    this.lamps = [];
    this.own = { masks: [], lamps: [] }; // the settings'
    this.tool = "look";
    this.selected = null; // { kind: "masks" or "lamps", key }
    this.drawing = null; // places of the polygon or stroke being drawn
    this.drag = null;
    this.cross = null; // a place, while the disc has the focus
    this.inputAt = -Infinity;
    this.values = new SkyValues(() => this.tell());
    this.items = new SkyItems(this);
    for (const id of ["sky-tools", "sky-values", "mask-mode", "brush-width"]) this[id] = document.getElementById(id);
    const disc = sky.canvas;
    for (const key of this["sky-tools"].querySelectorAll("[data-tool]")) key.addEventListener("click", () => this.use(key.dataset.tool));
    disc.addEventListener("pointerdown", (event) => this.down(event));
    disc.addEventListener("pointermove", (event) => this.move(event));
    disc.addEventListener("pointerup", (event) => this.up(event));
    disc.addEventListener("pointercancel", () => this.cancel());
    disc.addEventListener("pointerleave", () => this.tell(null));
    disc.addEventListener("dblclick", () => this.close());
    disc.addEventListener("keydown", (event) => this.key(event));
    disc.addEventListener("blur", () => { this.cross = null; this.tell(null); sky.draw(); });
    sky.overlay = (c, radius, unit) => drawTools(this, c, radius, unit);
  }

  take(summary) {
    this["sky-tools"].hidden = Boolean(summary.why_no_controls);
    this.own = summary.settings;
    if (this.told) this.tell(); // the sky moves also under a pointer that rests
    if (this.drag || performance.now() - this.inputAt < HOLD_MS) return;
    this.show(summary.control);
  }

  // What was chosen before is chosen again.
  adopt(change) {
    this.inputAt = performance.now();
    this.show(change, true);
  }

  // Masks and lamps as a control has them, null as the settings do; without a key they stay.
  show(control, anew = false) {
    const before = JSON.stringify([this.masks, this.lamps]);
    for (const kind of ["masks", "lamps"]) if (kind in control) this[kind] = control[kind] ?? this.own[kind];
    if (before === JSON.stringify([this.masks, this.lamps])) return;
    if (!this.item()) this.selected = null;
    this.items.show(anew);
    this.sky.draw();
  }

  // For the facts over the sky.
  get facts() {
    const count = (n, word) => (n ? ` · ${n} ${word}${n > 1 ? "s" : ""}` : "");
    return count(this.masks.length, "mask") + count(this.lamps.length, "lamp");
  }

  use(tool) {
    this.cancel();
    this.tool = tool;
    this.sky.canvas.dataset.tool = tool;
    for (const key of this["sky-tools"].querySelectorAll("[data-tool]")) key.setAttribute("aria-pressed", String(key.dataset.tool === tool));
    for (const field of this["sky-tools"].querySelectorAll("[data-for]")) field.hidden = !field.dataset.for.split(" ").includes(tool);
  }

  select(selected) {
    this.selected = selected;
    this.items.show();
    this.sky.draw();
  }

  item() {
    if (!this.selected) return null;
    return this.selected.kind === "masks" ? this.masks[this.selected.key] : this.lamps.find((lamp) => lamp.id === this.selected.key);
  }

  // Replaces, or with null removes, the selected mask or lamp.
  change(item) {
    const { kind, key } = this.selected;
    const isIt = (each, k) => (kind === "masks" ? k === key : each.id === key);
    this.send(kind, item ? this[kind].map((each, k) => (isIt(each, k) ? item : each)) : this[kind].filter((each, k) => !isIt(each, k)));
    if (!item) this.select(null);
  }

  send(kind, list) {
    this.inputAt = performance.now();
    this[kind] = list;
    this.choose({ [kind]: list });
    this.items.show();
    this.sky.draw();
  }

  // ---- pointer

  place(event) {
    const box = this.sky.canvas.getBoundingClientRect(), radius = box.width / 2 - RIM;
    return [(event.clientX - box.left - box.width / 2) / radius, (event.clientY - box.top - box.height / 2) / radius];
  }

  get reach() {
    return REACH / (this.sky.canvas.clientWidth / 2 - RIM);
  }

  down(event) {
    if (this["sky-tools"].hidden || event.button || !event.isPrimary) return; // a second finger draws nothing
    const at = this.place(event);
    this.sky.canvas.setPointerCapture(event.pointerId);
    this.drag = { from: at, at, x: event.clientX, y: event.clientY, moved: false };
    if (this.tool === "brush") this.drawing = [at];
    if (this.tool !== "look") return;
    this.drag.grip = this.grip(at);
    if (this.drag.grip) this.select({ kind: this.drag.grip.kind, key: this.drag.grip.key });
  }

  move(event) {
    const at = this.place(event), drag = this.drag;
    this.tell(at);
    if (!drag || !event.isPrimary) return;
    drag.moved ||= Math.hypot(event.clientX - drag.x, event.clientY - drag.y) >= LEAST_DRAG;
    if (!drag.moved) return;
    if (this.tool === "brush" && Math.hypot(at[0] - drag.at[0], at[1] - drag.at[1]) > BRUSH_SPACING) this.drawing.push(at);
    drag.at = at;
    if (drag.grip) this.change(this.pulled(drag.grip, drag.from, at));
    this.sky.draw();
  }

  up(event) {
    if (!event.isPrimary) return;
    const drag = this.drag;
    this.drag = null;
    if (!drag) return;
    const at = this.place(event);
    if (this.tool === "polygon") this.corner(at);
    else if (this.tool === "brush") this.finish(simplified(this.drawing, BRUSH_SPACING, MAX_MASK_POINTS), Number(this["brush-width"].value));
    else if (this.tool === "lamp") this.addLamp(drag.from, drag.moved ? 2 * Math.hypot(at[0] - drag.from[0], at[1] - drag.from[1]) * this.span : LAMP_DEG);
    else if (!drag.grip) this.select(null);
    this.sky.draw();
  }

  get span() {
    return spanOf(this.sky.coverage);
  }

  // What lies under a place: the selected lamp's rim, a lamp, a corner of the selected mask, a mask.
  grip(at) {
    const near = (place) => Math.hypot(place[0] - at[0], place[1] - at[1]) < this.reach, item = this.item();
    const places = (mask) => mask.points.map((point) => placeFrom(point, this.sky.coverage));
    if (item && this.selected.kind === "lamps" && near(this.rimOf(item))) return { ...this.selected, item, part: "size" };
    const lamp = this.lamps.find((each) => near(placeFrom([each.azimuth_deg, each.elevation_deg], this.sky.coverage)));
    if (lamp) return { kind: "lamps", key: lamp.id, item: lamp, part: "all" };
    const corner = item && this.selected.kind === "masks" ? places(item).findIndex(near) : -1;
    if (corner >= 0) return { ...this.selected, item, part: corner };
    const key = this.masks.findLastIndex((mask) =>
      mask.width_deg ? distanceTo(at, places(mask)) < mask.width_deg / 2 / this.span : isInside(at, places(mask)));
    return key >= 0 ? { kind: "masks", key, item: this.masks[key], part: "all" } : null;
  }

  // An item as a drag from one place to another leaves it.
  pulled({ kind, item, part }, from, to) {
    const moved = (direction) => {
      const [x, y] = placeFrom(direction, this.sky.coverage);
      return directionFrom([x + to[0] - from[0], y + to[1] - from[1]], this.sky.coverage);
    };
    if (kind === "masks") return { ...item, points: item.points.map((point, k) => (part === "all" || part === k ? moved(point) : point)) };
    if (part === "all") return withDirection(item, moved([item.azimuth_deg, item.elevation_deg]));
    const [x, y] = placeFrom([item.azimuth_deg, item.elevation_deg], this.sky.coverage);
    return { ...item, size_deg: hundredths(Math.min(MAX_LAMP_DEG, 2 * Math.hypot(to[0] - x, to[1] - y) * this.span)) };
  }

  // ---- what is drawn and added

  corner(at) {
    const first = this.drawing?.[0];
    if (first && this.drawing.length > 2 && Math.hypot(first[0] - at[0], first[1] - at[1]) < this.reach) return this.close();
    this.drawing = [...(this.drawing ?? []), at];
    if (this.drawing.length === MAX_MASK_POINTS) this.close();
  }

  close() {
    if (this.tool !== "polygon" || !this.drawing) return;
    const apart = this.drawing.filter((place, k) => k === 0 || distanceTo(place, [this.drawing[k - 1]]) > 1e-3); // a double click gives two
    apart.length > 2 ? this.finish(apart, 0) : this.notice("sky", "A polygon has three corners or more.");
  }

  finish(places, width_deg) {
    this.drawing = null;
    const points = places.map((place) => directionFrom(place, this.sky.coverage));
    const all = this.masks.reduce((sum, mask) => sum + mask.points.length, points.length);
    const full = this.masks.length >= MAX_MASKS ? `There are ${MAX_MASKS} masks, the most: remove one.`
      : all > MAX_POINTS ? `Masks have ${MAX_POINTS} points together, the most: remove one.` : "";
    this.notice("sky", full);
    if (full) return;
    this.send("masks", [...this.masks, { points, mode: this["mask-mode"].value, width_deg }]);
    this.select({ kind: "masks", key: this.masks.length - 1 });
  }

  // White, a quarter of the light that there is, or 1 in the dark.
  addLamp(place, size_deg) {
    const full = this.lamps.length >= MAX_LAMPS;
    this.notice("sky", full ? `There are ${MAX_LAMPS} virtual lamps, the most: remove one.` : "");
    if (full) return;
    const id = [...Array(MAX_LAMP_ID).keys()].find((k) => !this.lamps.some((lamp) => lamp.id === k + 1)) + 1;
    const level = Number((this.sky.power > 0 ? this.sky.power / 4 : 1).toPrecision(3));
    const lamp = { id, azimuth_deg: 0, elevation_deg: 0, irradiance: [level, level, level], size_deg: hundredths(Math.min(MAX_LAMP_DEG, size_deg)) };
    this.send("lamps", [...this.lamps, withDirection(lamp, directionFrom(place, this.sky.coverage))]);
    this.use("look");
    this.select({ kind: "lamps", key: id });
  }

  cancel() {
    [this.drawing, this.drag] = [null, null];
    this.notice("sky", "");
    this.sky.draw();
  }

  // ---- keys: arrows move the selected item, or else the cross; Enter puts a corner or a lamp there

  key(event) {
    const arrow = ARROWS[event.key], step = (event.shiftKey ? WIDE_STEP_DEG : STEP_DEG) / this.span;
    if (event.ctrlKey || event.metaKey || event.altKey || this["sky-tools"].hidden) return;
    if (arrow && this.selected && this.tool === "look") {
      this.change(this.pulled({ ...this.selected, item: this.item(), part: "all" }, [0, 0], [arrow[0] * step, arrow[1] * step]));
    } else if (arrow) {
      const [x, y] = this.cross ?? [0, 0], to = [x + arrow[0] * step, y + arrow[1] * step], far = Math.max(1, Math.hypot(...to));
      this.cross = [to[0] / far, to[1] / far];
      this.tell(this.cross);
    } else if (event.key === "Enter" && this.tool === "polygon") {
      const last = this.drawing?.at(-1), at = this.cross ?? [0, 0];
      last && distanceTo(at, [last]) < 1e-6 ? this.close() : this.corner(at);
    } else if (event.key === "Enter" && this.tool === "brush") {
      this.finish([this.cross ?? [0, 0]], Number(this["brush-width"].value));
    } else if (event.key === "Enter" && this.tool === "lamp") {
      this.addLamp(this.cross ?? [0, 0], LAMP_DEG);
    } else if (event.key === "Enter") {
      const grip = this.grip(this.cross ?? [0, 0]);
      this.select(grip && { kind: grip.kind, key: grip.key });
    } else if (event.key === "Escape") {
      this.drawing ? this.cancel() : this.tool !== "look" ? this.use("look") : this.select(null);
    } else if (event.key === "Backspace" && this.drawing) {
      this.drawing = this.drawing.length > 1 ? this.drawing.slice(0, -1) : null;
    } else if (["Delete", "Backspace"].includes(event.key) && this.selected) {
      this.change(null);
    } else {
      return;
    }
    event.preventDefault();
    this.sky.draw();
  }

  // Says what is at a place, or again what was said before with newer numbers; of null nothing.
  tell(place = this.told) {
    this.told = place;
    if (place) this.values.ask();
    const [azimuth, elevation] = place ? directionFrom(place, this.sky.coverage) : [0, 0], rad = Math.PI / 180;
    const seen = place && Math.hypot(...place) <= 1;
    this["sky-values"].textContent = seen ? this.values.text((90 - elevation) * rad, azimuth * rad) : "Point at the sky for its luminance.";
  }

  rimOf(lamp) {
    const [x, y] = placeFrom([lamp.azimuth_deg, lamp.elevation_deg], this.sky.coverage);
    return [x, y + Math.max(lamp.size_deg / 2 / this.span, 1.6 * this.reach)];
  }
}

function withDirection(lamp, [azimuth_deg, elevation_deg]) {
  return { ...lamp, azimuth_deg, elevation_deg };
}
