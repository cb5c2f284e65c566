// The camera by hand: drags, wheel, fingers and keys over the picture. What a handle of the gizmo takes does not come here.

import { distance, look, orbit, travel, zoom } from "/relit_camera.js";

const TURN_RAD = Math.PI; // for a drag across the whole height of the picture
const WHEEL = 0.0015; // of ln distance for a CSS pixel of the wheel; 0.0005 to 0.003 would do
const STEP = 0.06; // of the distance to what is looked at, for a key; with Shift five of them
const TURN_STEP_RAD = (3 * Math.PI) / 180; // for a key
const LEAST_DRAG = 4; // CSS pixels: less is a click, which selects

export class RelitHands {
  // relit: has scene, view, turn(view), toggleFull() and takes presets.
  constructor(relit) {
    this.relit = relit;
    this.pad = document.getElementById("gizmo"); // on top of the pictures; it has the focus
    this.stage = this.pad.parentElement;
    this.fingers = new Map(); // where each pointer was last
    this.stage.addEventListener("pointerdown", (event) => this.down(event));
    this.stage.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel"]) this.stage.addEventListener(kind, (event) => this.up(event));
    this.stage.addEventListener("mousedown", (event) => { if (event.target.matches("canvas")) event.preventDefault(); }); // the focus stays on the pad
    this.stage.addEventListener("contextmenu", (event) => event.preventDefault());
    this.stage.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.pad.addEventListener("keydown", (event) => this.key(event));
  }

  down(event) {
    if (!this.relit.scene || !event.target.matches("canvas")) return;
    this.pad.focus({ preventScroll: true });
    this.fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, travelled: 0, button: event.button });
  }

  move(event) {
    const finger = this.fingers.get(event.pointerId), { relit } = this;
    if (!finger || !relit.view) return;
    const dx = event.clientX - finger.x, dy = event.clientY - finger.y, others = [...this.fingers].filter(([id]) => id !== event.pointerId);
    if ((finger.travelled += Math.hypot(dx, dy)) < LEAST_DRAG) return;
    if (!this.stage.hasPointerCapture(event.pointerId)) this.stage.setPointerCapture(event.pointerId);
    const height = this.stage.clientHeight, turn = TURN_RAD / height;
    if (others.length) this.pinch(finger, others[0][1], dx, dy);
    else if (finger.button || event.shiftKey) relit.turn(this.panned(dx, dy));
    else relit.turn((event.altKey ? look : orbit)(relit.view, dx * turn, dy * turn));
    Object.assign(finger, { x: event.clientX, y: event.clientY });
  }

  // One of two fingers has moved: their distance is the zoom, their middle moves the scene.
  pinch(finger, other, dx, dy) {
    const before = Math.hypot(finger.x - other.x, finger.y - other.y), now = Math.hypot(finger.x + dx - other.x, finger.y + dy - other.y);
    this.relit.turn(zoom(this.panned(dx / 2, dy / 2), Math.max(before, 1) / Math.max(now, 1)));
  }

  // What is looked at stays under the pointer.
  panned(dx, dy) {
    const { view } = this.relit, metres = (2 * distance(view) * Math.tan((view.fov_y * Math.PI) / 360)) / this.stage.clientHeight;
    return travel(view, -dx * metres, -dy * metres, 0);
  }

  up(event) {
    this.fingers.delete(event.pointerId);
  }

  // Once the picture has been clicked, or with Ctrl: else the page scrolls.
  wheel(event) {
    const { relit } = this;
    if (!relit.view || !(event.ctrlKey || this.stage.contains(document.activeElement) || document.fullscreenElement)) return;
    event.preventDefault();
    relit.turn(zoom(relit.view, Math.exp(WHEEL * (event.deltaMode ? 33 * event.deltaY : event.deltaY))));
  }

  key(event) {
    const { relit } = this, { view } = relit;
    if (!view || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = STEP * distance(view), turned = this.turnedBy(event, view, event.shiftKey ? 5 * step : step);
    if (turned) relit.turn(turned);
    else if (event.key === "Home") relit.home();
    else if (event.key.toLowerCase() === "f") relit.toggleFull();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  turnedBy({ key, shiftKey }, view, step) {
    const angle = TURN_STEP_RAD;
    switch (key.length === 1 ? key.toLowerCase() : key) {
      case "ArrowLeft": return shiftKey ? travel(view, -step / 5, 0, 0) : orbit(view, angle, 0);
      case "ArrowRight": return shiftKey ? travel(view, step / 5, 0, 0) : orbit(view, -angle, 0);
      case "ArrowUp": return shiftKey ? travel(view, 0, -step / 5, 0) : orbit(view, 0, angle);
      case "ArrowDown": return shiftKey ? travel(view, 0, step / 5, 0) : orbit(view, 0, -angle);
      case "+": case "=": return zoom(view, 1 / 1.1);
      case "-": case "_": return zoom(view, 1.1);
      case "i": return travel(view, 0, 0, step);
      case "k": return travel(view, 0, 0, -step);
      case "j": return travel(view, -step, 0, 0);
      case "l": return travel(view, step, 0, 0);
      case "u": return travel(view, 0, -step, 0);
      case "o": return travel(view, 0, step, 0);
      default: return null;
    }
  }
}
