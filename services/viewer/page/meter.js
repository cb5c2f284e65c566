// The light meter: asks GET /meter for readings while somebody can see it, and lays false colours and zebra over the sky and the picture.

import { NEAR_IDS, VIRTUAL_IDS_FROM } from "/constants.js";
import { FalseColours, paintPicture } from "/false_colours.js";
import { drawHistogram } from "/meter_histogram.js";
import { grouped } from "/numbers.js";

const PERIOD_MS = 250; // figures that change faster nobody reads
const SHOWN_LIGHTS = 8;
const STEP = 5; // degrees of an arrow key
const at = (id) => document.getElementById(id);

export class Meter {
  constructor(sky) {
    this.sky = sky;
    this.look = { azimuth: 90, elevation: 0 };
    this.perUnit = 0; // cd/m2 a unit that the person has measured; 0: none
    this.readings = null;
    this.live = true;
    this.falseColours = new FalseColours();
    this.visible = false;
    this.colours = new Map(); // of lights, by id: words
    this.buttons = { colour: this.toggle("false-colour"), zebra: this.toggle("zebra") };
    for (const id of ["meter-azimuth", "meter-elevation"]) {
      at(id).addEventListener("input", () => this.enter());
      at(id).addEventListener("blur", () => this.turn({})); // then it has the number that counts
    }
    at("meter-eye").addEventListener("click", () => this.turn({ elevation: 0 }));
    at("meter-table").addEventListener("click", () => this.turn({ elevation: 90 }));
    at("meter-measured").addEventListener("change", () => this.calibrate());
    const dial = at("meter-dial");
    dial.addEventListener("pointerdown", (event) => { dial.setPointerCapture(event.pointerId); this.drag(event); });
    dial.addEventListener("pointermove", (event) => { if (event.buttons) this.drag(event); });
    dial.addEventListener("keydown", (event) => this.key(event));
    sky.more = (light) => this.colours.get(light.id) ?? "";
    new IntersectionObserver(([entry]) => { this.visible = entry.isIntersecting; }).observe(at("meter"));
    new ResizeObserver(() => this.show()).observe(at("meter-histogram"));
    document.addEventListener("themechange", () => this.show());
    this.turn({});
    this.ask();
  }

  toggle(id) {
    const button = at(id);
    button.addEventListener("click", () => {
      button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
      this.overlay();
    });
    return button;
  }

  on(name) {
    return this.buttons[name].getAttribute("aria-pressed") === "true";
  }

  // Whether maps still come: values that no longer come are said to be old.
  take(summary) {
    const maker = (kind) => summary.services.find((service) => service.kind === kind), row = maker("fuse") ?? maker("capture");
    this.live = !row || ["live", "finished"].includes(row.state);
    this.why = row ? `${row.service} ${row.text}` : "";
    this.showState();
  }

  // The viewer is away: what stands here is old.
  lose() {
    [this.live, this.why] = [false, "the viewer does not answer"];
    this.showState();
  }

  async ask() {
    const wanted = this.sky.image && document.visibilityState === "visible" && (this.visible || this.on("colour") || this.on("zebra"));
    try {
      if (wanted) {
        const query = new URLSearchParams({ ...this.look, scale: this.perUnit });
        const answer = await fetch(`/meter?${query}`);
        if (answer.ok) {
          this.readings = await answer.json();
          this.show();
        }
        if (this.on("colour") || this.on("zebra")) {
          const cells = await fetch("/meter/cells");
          if (cells.ok) this.falseColours.take(await cells.arrayBuffer());
        }
        this.overlay();
      }
    } catch { /* the viewer is away, which the page says by itself */ }
    setTimeout(() => this.ask(), PERIOD_MS);
  }

  drag(event) {
    const box = at("meter-dial").getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * 2 - 1, y = (event.clientY - box.top) / box.height * 2 - 1;
    this.turn({ azimuth: Math.round((Math.atan2(-y, -x) * 180) / Math.PI), elevation: Math.round(90 - 180 * Math.min(1, Math.hypot(x, y) / 0.94)) });
  }

  key(event) {
    const change = {
      ArrowLeft: { azimuth: this.look.azimuth - STEP }, ArrowRight: { azimuth: this.look.azimuth + STEP },
      ArrowUp: { elevation: this.look.elevation + STEP }, ArrowDown: { elevation: this.look.elevation - STEP },
    }[event.key];
    if (!change) return;
    event.preventDefault();
    this.turn(change);
  }

  enter() {
    const [azimuth, elevation] = ["meter-azimuth", "meter-elevation"].map((id) => at(id).valueAsNumber);
    if (!Number.isNaN(azimuth) && !Number.isNaN(elevation)) this.turn({ azimuth, elevation });
  }

  turn(change) {
    const { azimuth, elevation } = { ...this.look, ...change };
    this.look = { azimuth: ((Math.round(azimuth) % 360) + 360) % 360, elevation: Math.max(-90, Math.min(90, Math.round(elevation))) };
    for (const name of ["azimuth", "elevation"]) {
      if (document.activeElement !== at(`meter-${name}`)) at(`meter-${name}`).value = this.look[name];
    }
    this.drawDial();
  }

  // What a real meter shows on this plane gives the scale of a map that has none.
  async calibrate() {
    const measured = at("meter-measured").valueAsNumber;
    try {
      const answer = measured > 0 && (await fetch(`/meter?${new URLSearchParams(this.look)}`));
      const relative = answer?.ok ? (await answer.json()).plane.illuminance : 0;
      this.perUnit = relative > 0 ? measured / relative : 0;
    } catch { /* as above: nothing is known of a plane now */ }
  }

  show() {
    this.showState();
    const { readings } = this;
    if (!readings) return;
    const { plane, glare, scale } = readings, unit = scale ? " lx" : " (relative)";
    at("meter-illuminance").textContent = `${figure(plane.illuminance)}${unit}`;
    at("meter-plane-colour").textContent = colourWords(plane) || "no colour temperature";
    at("meter-whole").textContent = `${colourWords(readings.whole) || "no colour temperature"} · mean ${figure(readings.mean * (scale ?? 1))}${scale ? " cd/m²" : ""}`;
    at("meter-glare").textContent = glare ? `DGP ${glare.dgp.toFixed(2)} · ${glare.grade}` : "needs a scale";
    at("meter-glare-note").textContent = glareNote(readings);
    at("meter-calibrate").hidden = readings.scale_from === "map";
    this.showLights(readings);
    at("meter-range").textContent = rangeWords(readings);
    drawHistogram(at("meter-histogram"), readings);
    at("meter-histogram").setAttribute("aria-label", `Histogram of luminance in stops: ${rangeWords(readings)}`);
    this.drawDial();
  }

  showState() {
    const pill = at("meter-state"), { readings } = this;
    const [state, text] = !readings ? ["waiting", this.sky.image ? "reading …" : "waiting for a map"] : !this.live ? ["stalled", `last values: ${this.why}`]
      : readings.scale_from === "map" ? ["live", "calibrated, cd/m²"] : readings.scale_from === "page" ? ["live", "by your figure, cd/m²"]
      : ["starting", "relative: the camera has no scale"];
    if (pill.textContent !== text) pill.textContent = text;
    pill.dataset.state = state;
  }

  showLights({ lights, scale }) {
    this.colours = new Map(lights.map((light) => [light.id, `, ${colourWords(light) || "no colour temperature"}`]));
    const rows = lights.slice(0, SHOWN_LIGHTS).map((light) => {
      const row = document.createElement("tr");
      const cells = [nameOf(light.id), `${figure(light.illuminance)}${scale ? " lx" : ""}`, light.temperature_k ? `${light.temperature_k.toFixed(0)} K` : "–", duvWords(light.duv)];
      row.append(...cells.map((text, k) => Object.assign(document.createElement(k ? "td" : "th"), { textContent: text }, k ? {} : { scope: "row" })));
      return row;
    });
    at("meter-lights").replaceChildren(...rows);
    const left = lights.length - SHOWN_LIGHTS;
    at("meter-more").textContent = left > 0 ? `and ${left} weaker: point at a light in the sky for its colour` : "";
  }

  overlay() {
    const colour = this.on("colour"), zebra = this.on("zebra");
    this.sky.falseColours = colour || zebra ? this.falseColours.disc(colour, zebra) : null;
    this.sky.draw();
    paintPicture(at("picture"), at("picture-meter"), colour, zebra);
    this.falseColours.legend(at("colour-scale"), colour, this.readings?.scale);
  }

  drawDial() {
    const canvas = at("meter-dial"), side = Math.round(canvas.clientWidth * devicePixelRatio);
    if (!side) return;
    if (canvas.width !== side) canvas.width = canvas.height = side;
    const c = canvas.getContext("2d"), style = getComputedStyle(document.documentElement), unit = devicePixelRatio, radius = 0.47 * side;
    c.setTransform(1, 0, 0, 1, side / 2, side / 2);
    c.clearRect(-side, -side, 2 * side, 2 * side);
    c.strokeStyle = style.getPropertyValue("--edge");
    c.lineWidth = unit;
    for (const part of [0.5, 1]) {
      c.beginPath();
      c.arc(0, 0, part * radius, 0, 2 * Math.PI);
      c.stroke();
    }
    const phi = (this.look.azimuth * Math.PI) / 180, r = (radius * (90 - this.look.elevation)) / 180;
    c.fillStyle = c.strokeStyle = style.getPropertyValue("--light");
    c.lineWidth = 2 * unit;
    c.beginPath();
    c.moveTo(0, 0);
    c.lineTo(-r * Math.cos(phi), -r * Math.sin(phi));
    c.stroke();
    c.beginPath();
    c.arc(-r * Math.cos(phi), -r * Math.sin(phi), 6 * unit, 0, 2 * Math.PI);
    c.fill();
  }
}

function nameOf(id) {
  return id >= VIRTUAL_IDS_FROM ? `lamp ${id - VIRTUAL_IDS_FROM}` : id >= NEAR_IDS ? `near ${id - NEAR_IDS}` : id;
}

function colourWords({ temperature_k, duv }) {
  return temperature_k === null ? "" : `${temperature_k.toFixed(0)} K, Duv ${duvWords(duv)}`;
}

function duvWords(duv) {
  return duv === null ? "–" : `${duv < 0 ? "−" : "+"}${Math.abs(duv).toFixed(4)}`;
}

// Three digits, as photometers show them.
export function figure(value) {
  if (!(value > 0)) return "0";
  if (value < 0.01 || value >= 1e6) return value.toExponential(2).replace("e", " × 10^").replace("+", "");
  return grouped(Number(value.toPrecision(3)));
}

function rangeWords({ histogram, black, clipped, clipped_pixels }) {
  const stops = histogram.area.length * histogram.step;
  const over = clipped_pixels ? `clipped about ${(100 * clipped).toFixed(2)} % of the sky (${clipped_pixels} pixel values)` : "nothing clipped";
  return `${stops.toFixed(1)} stops · black ${(100 * black).toFixed(1)} % · ${over}`;
}

function glareNote({ glare, coverage, cell_degrees }) {
  if (!glare) return "Daylight glare probability takes luminance in cd/m²: calibrate the camera, or say below what a light meter shows.";
  const words = [`${glare.sources} glare source${glare.sources === 1 ? "" : "s"}`];
  if (!glare.valid) words.push("below 380 lx the formula does not hold");
  if (coverage === "hemisphere") words.push("the lower half of the view counts as dark");
  return `${words.join("; ")}. Cells of ${cell_degrees}°.`;
}
