// The fixtures: the rig in space, each lamp with its light, the levels, what is not matched in words, and the keys that arm, stop and darken.

const HELD_MS = 1500; // without new lights: the last look is held. 1 to 5 s would do
const TURN = 0.008; // rad a pixel of a drag
const STEP = 0.15; // rad a press of an arrow key
const REACH = 16; // CSS pixels around a fixture within which the pointer selects it
const BAR_COLOURS = ["#f37c73", "#62c794", "#6fa3f5", "#e4eaf1", "#f3b95f", "#b6e36a"]; // by the emitter's number: most begin red, green, blue

export class Fixtures {
  constructor(choose) {
    this.choose = choose;
    for (const id of ["fixtures", "fixtures-state", "fixtures-text", "fixture-facts", "rig", "levels", "why-not-arm", "arm", "stop", "blackout", "arm-dialog"]) {
      this[id] = document.getElementById(id);
    }
    this.frame = null;
    this.azimuth = 0.9;
    this.elevation = 0.35;
    this.pointer = null;
    this.armed = this.dark = false;
    this.arm.addEventListener("click", () => this["arm-dialog"].showModal());
    document.getElementById("arm-now").addEventListener("click", () => { this["arm-dialog"].close(); this.choose({ armed: true }); });
    document.getElementById("arm-cancel").addEventListener("click", () => this["arm-dialog"].close());
    this.stop.addEventListener("click", () => this.choose({ armed: false }));
    this.blackout.addEventListener("click", () => this.choose({ blackout: !this.dark }));
    document.addEventListener("keydown", (event) => this.key(event));
    this.rig.addEventListener("pointerdown", (event) => { this.rig.setPointerCapture(event.pointerId); this.drag = event; });
    this.rig.addEventListener("pointerup", () => { this.drag = null; });
    this.rig.addEventListener("pointermove", (event) => this.move(event));
    this.rig.addEventListener("pointerleave", () => { this.pointer = null; this.draw(); });
    new ResizeObserver(() => this.draw()).observe(this.rig);
  }

  // Whether there is a rig, and whether its packets are live.
  take(summary) {
    this.fixtures.hidden = !summary.fixtures;
    if (!summary.fixtures) return;
    const why = summary.fixtures.why_not_arm, row = summary.services.find((each) => each.kind === "fixtures");
    const report = row?.report ?? {};
    this.armed = report.armed === 1;
    this.dark = report.blackout === 1;
    this.fixtures.dataset.armed = this.armed;
    this["why-not-arm"].hidden = !why;
    this["why-not-arm"].textContent = why;
    this.arm.disabled = this.armed || Boolean(why) || row?.state === "not seen";
    this.stop.disabled = !this.armed && summary.control.armed !== true;
    this.blackout.setAttribute("aria-pressed", String(this.dark));
    this.blackout.textContent = this.dark ? "Dark: light again" : "Blackout";
    const held = report.held_ms > HELD_MS && this.frame ? `, last look held for ${(report.held_ms / 1e3).toFixed(0)} s` : "";
    const [state, text] = ["silent", "not seen"].includes(row?.state) ? [row.state, row.text]
      : this.armed ? (this.dark ? ["blackout", "armed, dark"] : [held ? "held" : "armed", `armed: live${held}`])
      : ["preview", `preview, nothing is live${held}`];
    this["fixtures-state"].dataset.state = state;
    if (this["fixtures-state"].textContent !== text) this["fixtures-state"].textContent = text;
  }

  // One frame, as in `vemlight.levels/1`.
  show(frame) {
    this.frame = frame;
    this["fixtures-text"].textContent = frame.text;
    this.draw();
  }

  key(event) {
    if (event.key === "B" && event.shiftKey && !this.fixtures.hidden && !["INPUT", "SELECT"].includes(document.activeElement.tagName)) {
      this.choose({ blackout: !this.dark });
    }
    const turn = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] }[event.key];
    if (turn && document.activeElement === this.rig) {
      event.preventDefault();
      this.turn(...turn);
    }
  }

  move(event) {
    const box = this.rig.getBoundingClientRect();
    this.pointer = { x: event.clientX - box.left, y: event.clientY - box.top };
    if (this.drag) {
      this.turn(-(event.clientX - this.drag.clientX) * TURN, (event.clientY - this.drag.clientY) * TURN);
      this.drag = event;
    } else this.draw();
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(1.5, Math.max(-0.4, this.elevation + elevation));
    this.draw();
  }

  draw() {
    const width = Math.round(this.rig.clientWidth * devicePixelRatio), height = Math.round(this.rig.clientHeight * devicePixelRatio);
    if (!width || !this.frame) return;
    if (this.rig.width !== width || this.rig.height !== height) [this.rig.width, this.rig.height] = [width, height];
    const c = this.rig.getContext("2d"), unit = devicePixelRatio;
    c.clearRect(0, 0, width, height);
    const view = this.view(width, height);
    drawFloor(c, view, this.frame.target, unit);
    const lamps = this.frame.fixtures.map((fixture) => ({ fixture, at: view(fixture.at), aim: view(fixture.aim) })).sort((a, b) => b.at.depth - a.at.depth);
    c.globalCompositeOperation = "lighter";
    for (const lamp of lamps) drawBeam(c, lamp, unit);
    c.globalCompositeOperation = "source-over";
    for (const lamp of lamps) drawLamp(c, lamp, unit);
    drawHead(c, view, this.frame, unit);
    this.describe(lamps, unit);
    drawLevels(this.levels, this.frame.fixtures, unit);
  }

  // From a place in metres to the canvas: seen from around the target, far enough that the whole rig fits.
  view(width, height) {
    const { target, fixtures } = this.frame;
    const reach = Math.max(1, ...fixtures.map(({ at }) => Math.hypot(at[0] - target[0], at[1] - target[1], at[2] - target[2])));
    const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
    const distance = 3.2 * reach, scale = (0.44 * Math.min(width, height) * distance) / reach;
    return ([px, py, pz]) => {
      const [x, y, z] = [px - target[0], py - target[1], pz - target[2]];
      const right = -sa * x + ca * y, back = ca * x + sa * y, up = ce * z - se * back, depth = distance - (ce * back + se * z);
      const size = scale / Math.max(depth, 0.2 * reach);
      return { x: width / 2 + right * size, y: 0.5 * height - up * size, depth, size };
    };
  }

  describe(lamps, unit) {
    let best = null, distance = REACH;
    for (const lamp of this.pointer ? lamps : []) {
      const d = Math.hypot(lamp.at.x / unit - this.pointer.x, lamp.at.y / unit - this.pointer.y);
      if (d < distance) [best, distance] = [lamp.fixture, d];
    }
    const levels = best?.levels.map((level) => (100 * level).toFixed(1)).join(" · ");
    this["fixture-facts"].textContent = best ? `${best.name}: ${levels} %${best.limited ? ", at full" : ""}${best.off_gamut ? ", cannot mix the colour" : ""}`
      : "Point at a fixture for its levels.";
  }
}

// A fixture's light as a colour, at full brightness, and how bright it is, 0 to 1, as the eye orders it.
function lightOf({ light, levels }) {
  const top = Math.max(...light, 1e-9);
  const rgb = light.map((value) => Math.max(0, value / top)).join(" ");
  return { rgb, bright: Math.min(1, Math.max(...levels, 0)) ** 0.45 };
}

function drawBeam(c, { fixture, at, aim }, unit) {
  const { rgb, bright } = lightOf(fixture);
  if (bright < 0.01) return;
  const gradient = c.createLinearGradient(at.x, at.y, aim.x, aim.y);
  gradient.addColorStop(0, `color(srgb-linear ${rgb} / ${0.55 * bright})`);
  gradient.addColorStop(1, `color(srgb-linear ${rgb} / 0)`);
  const length = Math.hypot(aim.x - at.x, aim.y - at.y) || 1, spread = 0.16 * length;
  const [nx, ny] = [-(aim.y - at.y) / length, (aim.x - at.x) / length];
  c.fillStyle = gradient;
  c.beginPath();
  c.moveTo(at.x + 2 * unit * nx, at.y + 2 * unit * ny);
  c.lineTo(aim.x + spread * nx, aim.y + spread * ny);
  c.lineTo(aim.x - spread * nx, aim.y - spread * ny);
  c.lineTo(at.x - 2 * unit * nx, at.y - 2 * unit * ny);
  c.fill();
}

function drawLamp(c, { fixture, at }, unit) {
  const { rgb, bright } = lightOf(fixture), radius = Math.max(4.5 * unit, 0.1 * at.size);
  c.beginPath();
  c.arc(at.x, at.y, radius, 0, 2 * Math.PI);
  c.fillStyle = "#1d242c";
  c.fill();
  c.fillStyle = `color(srgb-linear ${rgb} / ${bright})`;
  c.fill();
  c.lineWidth = 1.2 * unit;
  c.strokeStyle = "#93a1b1";
  c.stroke();
  if (!fixture.limited && !fixture.off_gamut) return;
  c.beginPath();
  c.arc(at.x, at.y, radius + 3.5 * unit, 0, 2 * Math.PI);
  c.setLineDash(fixture.limited ? [] : [3 * unit, 3 * unit]);
  c.lineWidth = 2 * unit;
  c.strokeStyle = fixture.limited ? "#f37c73" : "#eeb54e";
  c.stroke();
  c.setLineDash([]);
}

// The floor under the target, in rings of a metre, with its axes.
function drawFloor(c, view, target, unit) {
  c.lineWidth = unit;
  for (let radius = 1; radius <= 4; radius++) {
    c.strokeStyle = "rgb(255 255 255 / 0.09)";
    c.beginPath();
    for (let k = 0; k <= 48; k++) {
      const { x, y } = view([target[0] + radius * Math.cos((k * Math.PI) / 24), target[1] + radius * Math.sin((k * Math.PI) / 24), 0]);
      k ? c.lineTo(x, y) : c.moveTo(x, y);
    }
    c.stroke();
  }
  c.font = `600 ${12 * unit}px system-ui, sans-serif`;
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillStyle = "#93a1b1";
  for (const [text, dx, dy] of [["+x", 4.3, 0], ["+y", 0, 4.3]]) {
    const { x, y } = view([target[0] + dx, target[1] + dy, 0]);
    c.fillText(text, x, y);
  }
}

// The head at the target, and an arrow to where most light is missing.
function drawHead(c, view, frame, unit) {
  const { target } = frame, head = view(target), foot = view([target[0], target[1], 0]);
  c.strokeStyle = "rgb(255 255 255 / 0.25)";
  c.lineWidth = 2 * unit;
  c.beginPath();
  c.moveTo(foot.x, foot.y);
  c.lineTo(head.x, head.y);
  c.stroke();
  c.beginPath();
  c.ellipse(head.x, head.y, 0.11 * head.size, 0.15 * head.size, 0, 0, 2 * Math.PI);
  c.fillStyle = "#3a444f";
  c.fill();
  c.stroke();
  if (frame.unmatched < 0.05) return;
  const end = view(target.map((value, k) => value + 0.9 * frame.unmatched_at[k]));
  const angle = Math.atan2(end.y - head.y, end.x - head.x);
  c.strokeStyle = c.fillStyle = "#eeb54e";
  c.beginPath();
  c.moveTo(head.x, head.y);
  c.lineTo(end.x, end.y);
  c.stroke();
  c.beginPath();
  c.moveTo(end.x, end.y);
  for (const side of [-0.4, 0.4]) c.lineTo(end.x - 9 * unit * Math.cos(angle + side), end.y - 9 * unit * Math.sin(angle + side));
  c.fill();
}

function drawLevels(canvas, fixtures, unit) {
  const width = Math.round(canvas.clientWidth * unit), height = Math.round(canvas.clientHeight * unit);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const c = canvas.getContext("2d"), margin = 8 * unit, column = (width - 2 * margin) / fixtures.length;
  c.clearRect(0, 0, width, height);
  fixtures.forEach(({ levels }, k) => levels.forEach((level, e) => {
    const bar = (0.8 * column) / levels.length;
    c.fillStyle = levels.length === 1 ? BAR_COLOURS[3] : BAR_COLOURS[e % BAR_COLOURS.length];
    const high = Math.max(unit, level * (height - 2 * margin));
    c.fillRect(margin + k * column + 0.1 * column + e * bar, height - margin - high, Math.max(0.85 * bar, unit), high);
  }));
}
