// False colours and zebra: of the sky by the luminance of its cells, of the picture by its display levels.

import { LUMINANCE_WEIGHTS } from "/constants.js";
import { shortNumber } from "/meter_histogram.js";

const SIDE = 384; // pixels of the disc's overlay
const HEAD = 16; // bytes of /meter/cells before the codes: rows, cols uint16; coverage uint32; first stop, stops a code float32
const BLACK = 0, CLIPPED = 255;
const OUTSIDE = 0.005; // of the sky, that is darker than the scale, and as much brighter: a sun takes 15 stops, and leaves the sky none. 0.002..0.02 do
const LEAST_STOPS = 2; // of the scale: an even sky has one colour, and no noise in false ones
const STRIPE = 5; // pixels of a zebra's stripe
const PICTURE_WIDTH = 320; // pixels of the picture's overlay
const WHITE_CODE = 254, BLACK_CODE = 1; // display codes from which a pixel is clipped, and up to which it is black
// Dark to bright without a jump, told apart by the colour-blind: matplotlib's inferno at six places.
const RAMP = [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]];

export class FalseColours {
  constructor() {
    this.cells = null;
    this.layout = "";
    this.canvas = document.createElement("canvas");
    this.canvas.width = this.canvas.height = SIDE;
  }

  take(buffer) {
    const view = new DataView(buffer), [rows, cols] = [view.getUint16(0, true), view.getUint16(2, true)];
    const sphere = view.getUint32(4, true) === 1;
    this.cells = new Uint8Array(buffer, HEAD);
    [this.first, this.step] = [view.getFloat32(8, true), view.getFloat32(12, true)];
    const layout = `${rows} ${cols}`;
    if (layout !== this.layout) [this.layout, this.lookup] = [layout, discLookup(rows, cols)];
    this.sphere = sphere;
    this.scale = scaleOf(this.cells, this.lookup, LEAST_STOPS / this.step);
  }

  // The overlay of the disc; null before cells have come.
  disc(colour, zebra) {
    if (!this.cells) return null;
    const c = this.canvas.getContext("2d"), image = c.createImageData(SIDE, SIDE), { low, high } = this.scale;
    for (let k = 0; k < SIDE * SIDE; k++) {
      if (this.lookup[k] < 0) continue;
      const code = this.cells[this.lookup[k]];
      const marked = zebra && (code === BLACK || code === CLIPPED);
      if (marked) paint(image.data, k, zebraColour(code === CLIPPED, k % SIDE, Math.floor(k / SIDE)));
      else if (colour) paint(image.data, k, ramp((code - low) / (high - low)));
    }
    c.putImageData(image, 0, 0);
    return this.canvas;
  }

  // The scale below the sky: colours and what luminance they stand for.
  legend(element, shown, scale) {
    element.hidden = !shown || !this.cells;
    if (element.hidden) return;
    const { low, high, least, most } = this.scale, stops = [low, (low + high) / 2, high].map((code) => this.first + Math.log2(scale ?? 1) + (code - 1) * this.step);
    const beyond = [least < low ? "≤ " : "", "", most > high ? "≥ " : ""];
    const text = stops.map((stop, k) => beyond[k] + (scale ? `${shortNumber(2 ** stop)} cd/m²` : `${stop.toFixed(1)} stops`.replace("-", "−")));
    [...element.querySelectorAll("output")].forEach((output, k) => { if (output.textContent !== text[k]) output.textContent = text[k]; });
  }
}

// Which codes the colours span: all but those of OUTSIDE of the sky at each end. Clipped cells are at least as bright as the brightest.
function scaleOf(cells, lookup, leastCodes) {
  const counts = new Uint32Array(256);
  for (const cell of lookup) if (cell >= 0) counts[Math.min(cells[cell], CLIPPED - 1)]++;
  const lit = counts.subarray(1).reduce((sum, count) => sum + count, 0), known = [...counts.keys()].filter((code) => code && counts[code]);
  if (!lit) return { low: 1, high: CLIPPED - 1, least: 1, most: CLIPPED - 1 };
  const codeAt = (part) => {
    let sum = 0;
    return known.find((code) => (sum += counts[code]) >= part * lit);
  };
  const high = codeAt(1 - OUTSIDE);
  return { low: Math.min(codeAt(OUTSIDE), high - leastCodes), high, least: known[0], most: known.at(-1) };
}

// The picture has no luminance any more: its colours tell its display levels, 0 to 100 %.
export function paintPicture(picture, overlay, colour, zebra) {
  overlay.hidden = !(colour || zebra) || !picture.width || picture.width < 2;
  if (overlay.hidden) return;
  const width = PICTURE_WIDTH, height = Math.max(1, Math.round((width * picture.height) / picture.width));
  if (overlay.width !== width || overlay.height !== height) [overlay.width, overlay.height] = [width, height];
  const c = overlay.getContext("2d", { willReadFrequently: true });
  c.imageSmoothingEnabled = false;
  c.drawImage(picture, 0, 0, width, height);
  const image = c.getImageData(0, 0, width, height), { data } = image;
  for (let k = 0; k < width * height; k++) {
    const [r, g, b] = [data[4 * k], data[4 * k + 1], data[4 * k + 2]];
    const over = Math.max(r, g, b) >= WHITE_CODE, under = Math.max(r, g, b) <= BLACK_CODE;
    if (zebra && (over || under)) paint(data, k, zebraColour(over, k % width, Math.floor(k / width)));
    else if (colour) paint(data, k, ramp((LUMINANCE_WEIGHTS[0] * r + LUMINANCE_WEIGHTS[1] * g + LUMINANCE_WEIGHTS[2] * b) / 255));
    else data[4 * k + 3] = 0;
  }
  c.putImageData(image, 0, 0);
}

function paint(data, k, [r, g, b]) {
  [data[4 * k], data[4 * k + 1], data[4 * k + 2], data[4 * k + 3]] = [r, g, b, 255];
}

function zebraColour(over, x, y) {
  const odd = Math.floor((x + y) / STRIPE) % 2;
  return over ? (odd ? [255, 255, 255] : [214, 32, 32]) : (odd ? [90, 150, 255] : [0, 0, 0]);
}

function ramp(part) {
  const place = Math.min(1, Math.max(0, part)) * (RAMP.length - 1), k = Math.min(RAMP.length - 2, Math.floor(place)), t = place - k;
  return RAMP[k].map((value, channel) => value + t * (RAMP[k + 1][channel] - value));
}

// The cell under each pixel of the disc, -1 outside it: as sky.js draws the map.
function discLookup(rows, cols) {
  const lookup = new Int32Array(SIDE * SIDE).fill(-1), centre = SIDE / 2;
  for (let k = 0; k < lookup.length; k++) {
    const right = ((k % SIDE) + 0.5 - centre) / centre, up = -(Math.floor(k / SIDE) + 0.5 - centre) / centre, r = Math.hypot(right, up);
    if (r >= 1) continue;
    const phi = (Math.atan2(up, -right) + 2 * Math.PI) % (2 * Math.PI);
    lookup[k] = Math.min(rows - 1, Math.floor(r * rows)) * cols + (Math.floor((phi / (2 * Math.PI)) * cols) % cols);
  }
  return lookup;
}
