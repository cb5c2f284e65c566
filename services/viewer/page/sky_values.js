// The map's luminance as numbers, asked for while somebody points at the sky.

import { grouped } from "/numbers.js";

const PERIOD_MS = 500; // between two askings; 200..2000 would do

export class SkyValues {
  constructor(changed) {
    this.changed = changed;
    this.map = null;
    this.asking = false;
    this.askedAt = -Infinity;
  }

  async ask() {
    if (this.asking || performance.now() - this.askedAt < PERIOD_MS) return;
    this.asking = true;
    this.askedAt = performance.now();
    try {
      const answer = await fetch("/sky.bin");
      this.map = answer.ok ? mapFrom(await answer.arrayBuffer()) : null;
      this.changed();
    } catch {
      this.map = null;
    }
    this.asking = false;
  }

  // What is seen in a direction, in words; theta from the zenith, phi from +X towards +Y, in rad.
  text(theta, phi) {
    const azimuth = `${degrees((phi + 2 * Math.PI) % (2 * Math.PI))}`, elevation = degrees(Math.PI / 2 - theta);
    const where = `Azimuth ${azimuth}°, elevation ${elevation}°`, map = this.map;
    if (!map || theta > map.span) return where;
    const row = Math.min(map.rows - 1, Math.floor((theta / map.span) * map.rows));
    const col = Math.floor((((phi / (2 * Math.PI)) % 1) + 1) * map.cols) % map.cols;
    const luminance = map.luminance[row * map.cols + col];
    const ring = Math.cos((row * map.span) / map.rows) - Math.cos(((row + 1) * map.span) / map.rows);
    const share = map.total > 0 ? (luminance * ring * 2 * Math.PI) / map.cols / map.total : 0;
    const value = map.scale ? `${number(luminance * map.scale)} cd/m²` : `${number(luminance)} in the map's unit`;
    return `${where}: ${value}, ${number(100 * share)} % of the power in ${((map.span / map.rows) * 180 / Math.PI).toFixed(0)}° here`;
  }
}

function mapFrom(buffer) {
  const head = new DataView(buffer), word = (k) => head.getUint16(4 + 2 * k, true);
  const [rows, cols, coverage] = [word(0), word(1), word(2)];
  if (head.getUint32(0) !== 0x736b7931) throw new Error("not the map's luminance");
  const luminance = new Float32Array(buffer, 20, rows * cols);
  return { rows, cols, luminance, span: coverage ? Math.PI : Math.PI / 2, scale: head.getFloat32(12, true), total: head.getFloat32(16, true) };
}

function degrees(angle) {
  return ((angle * 180) / Math.PI).toFixed(0);
}

// Three digits that count.
export function number(value) {
  if (!(Math.abs(value) >= 1e-4)) return value === 0 ? "0" : value.toExponential(1);
  return Math.abs(value) >= 1e6 ? value.toExponential(2) : grouped(Number(value.toPrecision(3)));
}
