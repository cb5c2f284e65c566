// The sky disc: the map, the lights on it, and a short trail of each light's last positions.
// Seen from below: zenith in the middle, +Y at the top, +X at the left, the angle from the zenith proportional to the radius.

import { LUMINANCE_WEIGHTS, NEAR_IDS, VIRTUAL_IDS_FROM } from "/constants.js";
import { traceDiamond } from "/sky_geometry.js";

const TRAIL_MS = 900;
const MAX_TRAIL_POINTS = 12000; // over all lights: 12 positions each for 1000 of them
const JUMP = 0.35; // of the radius: a light that moves farther within one frame has jumped, and its trail has a gap
const REACH = 14; // CSS pixels around a light within which the pointer selects it
const COMPASS = [["N", 90], ["E", 0], ["S", 270], ["W", 180]]; // azimuth in degrees from +X towards +Y; +Y is north

export class Sky {
  constructor(canvas, facts) {
    this.canvas = canvas;
    this.facts = facts;
    this.image = null;
    this.lights = [];
    this.trails = new Map(); // id -> [{x, y, at}], newest last
    this.pointer = null;
    this.coverage = "hemisphere";
    this.near = new Map(); // of near lights, which are among the others: id -> {distance_m, sigma_m}
    this.power = 0; // of all lights together
    this.overlay = null; // draws over all, in pixels from the middle: (context, radius of the disc, pixels in one of CSS)
    this.falseColours = null; // drawn over the map
    this.more = () => ""; // what else is known of a light
    canvas.addEventListener("pointermove", (event) => this.point(event));
    canvas.addEventListener("pointerdown", (event) => this.point(event));
    canvas.addEventListener("pointerleave", () => { this.pointer = null; this.draw(); });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(image) {
    this.image?.close();
    this.image = image;
    this.draw();
  }

  // One frame's lights, as in `vemlight.lights/1`.
  take(frame, now) {
    this.coverage = frame.coverage;
    const span = frame.coverage === "sphere" ? Math.PI : Math.PI / 2;
    const power = (light) => light.irradiance.reduce((sum, value, k) => sum + LUMINANCE_WEIGHTS[k] * value, 0);
    const total = frame.lights.reduce((sum, light) => sum + power(light), 0);
    this.power = total;
    this.lights = frame.lights.map((light) => {
      const [x, y, z] = light.direction;
      const theta = Math.atan2(Math.hypot(x, y), z), phi = Math.atan2(y, x), r = theta / span;
      const fraction = total > 0 ? power(light) / total : 0;
      return { id: light.id, x: -r * Math.cos(phi), y: -r * Math.sin(phi), theta, phi, fraction, colour: colour(light.irradiance), light };
    });
    const length = Math.max(4, Math.floor(MAX_TRAIL_POINTS / Math.max(1, this.lights.length)));
    const trails = new Map();
    for (const light of this.lights) {
      const old = (this.trails.get(light.id) ?? []).filter((position) => now - position.at < TRAIL_MS).slice(-length);
      trails.set(light.id, [...old, { x: light.x, y: light.y, at: now }]);
    }
    this.trails = trails;
    this.draw();
  }

  // How far the near lights are, of a summary.
  takeNear(near) {
    this.near = new Map(near.map(({ id, ...rest }) => [NEAR_IDS + id, rest]));
  }

  draw() {
    const side = Math.round(this.canvas.clientWidth * devicePixelRatio);
    if (!side) return;
    if (this.canvas.width !== side) this.canvas.width = this.canvas.height = side;
    const c = this.canvas.getContext("2d"), radius = side / 2, unit = devicePixelRatio;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, side, side);
    c.translate(radius, radius);
    const disc = radius - 19 * unit; // the compass letters are outside
    c.save();
    c.beginPath();
    c.arc(0, 0, disc, 0, 2 * Math.PI);
    c.fillStyle = "#0a0d10";
    c.fill();
    c.clip();
    for (const image of [this.image, this.falseColours]) if (image) c.drawImage(image, -disc, -disc, 2 * disc, 2 * disc);
    c.restore();
    drawRings(c, disc, unit, this.coverage);
    this.drawTrails(c, disc, unit);
    this.drawLights(c, disc, unit);
    this.overlay?.(c, disc, unit);
    this.describe(disc);
  }

  drawTrails(c, disc, unit) {
    c.lineWidth = 1.6 * unit;
    for (const light of this.lights) {
      const positions = this.trails.get(light.id);
      for (let k = 1; k < positions.length; k++) {
        const a = positions[k - 1], b = positions[k];
        if (Math.hypot(b.x - a.x, b.y - a.y) > JUMP || (a.x === b.x && a.y === b.y)) continue;
        c.strokeStyle = `rgb(255 255 255 / ${(0.75 * k) / positions.length})`;
        c.beginPath();
        c.moveTo(a.x * disc, a.y * disc);
        c.lineTo(b.x * disc, b.y * disc);
        c.stroke();
      }
    }
  }

  // A dot's area is proportional to the light's fraction of the power; together they cover a fixed part of the disc.
  drawLights(c, disc, unit) {
    for (const light of this.lights) {
      light.r = Math.min(0.075 * disc, Math.max(1.7 * unit, 0.26 * disc * Math.sqrt(light.fraction)));
      c.beginPath();
      c.arc(light.x * disc, light.y * disc, light.r, 0, 2 * Math.PI);
      c.fillStyle = light.colour;
      c.fill();
      c.lineWidth = 2.4 * unit;
      c.strokeStyle = "rgb(8 10 13 / 0.75)";
      c.stroke();
      c.lineWidth = 1 * unit;
      c.strokeStyle = "#fff";
      c.stroke();
      if (!this.near.has(light.id)) continue;
      traceDiamond(c, light.x * disc, light.y * disc, light.r + 4 * unit);
      c.stroke();
    }
  }

  point(event) {
    const box = this.canvas.getBoundingClientRect();
    this.pointer = { x: event.clientX - box.left - box.width / 2, y: event.clientY - box.top - box.height / 2 };
    this.draw();
  }

  // Describes the light under the pointer, or the strongest: its id, fraction of the power and direction.
  describe(disc) {
    if (!this.lights.length) {
      this.facts.textContent = this.image ? "No lights yet." : "The sky from below. Point at a light for its power and direction.";
      return;
    }
    const scale = disc / devicePixelRatio;
    let best = null, distance = REACH;
    for (const light of this.pointer ? this.lights : []) {
      const d = Math.hypot(light.x * scale - this.pointer.x, light.y * scale - this.pointer.y);
      if (d < distance) [best, distance] = [light, d];
    }
    const light = best ?? this.lights.reduce((a, b) => (b.fraction > a.fraction ? b : a));
    const azimuth = ((light.phi * 180) / Math.PI + 360) % 360, elevation = 90 - (light.theta * 180) / Math.PI;
    const near = this.near.get(light.id);
    const shown = light.id >= VIRTUAL_IDS_FROM ? `virtual lamp ${light.id - VIRTUAL_IDS_FROM}` : near ? `near light ${light.id - NEAR_IDS}` : `light ${light.id}`;
    const away = near ? `, ${near.distance_m.toFixed(2)} ± ${near.sigma_m.toFixed(2)} m away` : "";
    const name = best ? shown[0].toUpperCase() + shown.slice(1) : `Strongest ${shown}`;
    this.facts.textContent = `${name}: ${(100 * light.fraction).toFixed(1)} %, azimuth ${azimuth.toFixed(0)}°, elevation ${elevation.toFixed(0)}°${away}${this.more(light)}`;
  }
}

function drawRings(c, disc, unit, coverage) {
  c.lineWidth = unit;
  for (const part of [1 / 3, 2 / 3, 1]) {
    c.strokeStyle = part === 1 ? "rgb(255 255 255 / 0.28)" : "rgb(255 255 255 / 0.13)";
    c.beginPath();
    c.arc(0, 0, part * disc, 0, 2 * Math.PI);
    c.stroke();
  }
  if (coverage === "sphere") { // the horizon is half way to the rim
    c.strokeStyle = "rgb(255 255 255 / 0.4)";
    c.setLineDash([4 * unit, 4 * unit]);
    c.beginPath();
    c.arc(0, 0, disc / 2, 0, 2 * Math.PI);
    c.stroke();
    c.setLineDash([]);
  }
  c.font = `600 ${12 * unit}px system-ui, sans-serif`;
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillStyle = getComputedStyle(c.canvas).color;
  for (const [letter, azimuth] of COMPASS) {
    const phi = (azimuth * Math.PI) / 180, r = disc + 10 * unit;
    c.fillText(letter, -r * Math.cos(phi), -r * Math.sin(phi));
  }
}

// The light's chroma at full brightness; the browser converts from linear light.
function colour(irradiance) {
  const top = Math.max(...irradiance);
  return top > 0 ? `color(srgb-linear ${irradiance.map((value) => Math.max(0, value / top)).join(" ")})` : "#222";
}
