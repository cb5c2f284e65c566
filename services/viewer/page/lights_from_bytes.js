// A frame's lights from the bytes of the feed placed-lights.bin; docs/clients.md has the layout.

import { NEAR_IDS } from "/constants.js";

const HEAD_BYTES = 56, LAYOUT = 1, COVARIANCE = 6; // lights_binary.py
const MIN_DISTANCE_M = 1e-3; // near_lights.py

// { sequence, time_s, coverage, directional: [{ id, direction, irradiance, covariance }], near: [{ id, at, intensity, radius }], lights }. `lights`: the
// directional ones, and behind them the near ones as they are seen from where those are true. Throws an Error for bytes that are no such frame.
export function lightsFromBytes(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEAD_BYTES || view.getUint8(1) !== LAYOUT) throw new Error("lights in a layout that is not known: reload the page");
  const extent = view.getUint8(2), count = view.getUint32(4, true), nearCount = view.getUint32(48, true);
  const sizes = [3, 3, extent].map((size) => size * count).concat([3, 3, 1].map((size) => size * nearCount));
  const floats = HEAD_BYTES + 8 * (count + nearCount), bytes = floats + 4 * sizes.reduce((sum, size) => sum + size);
  if (![0, COVARIANCE].includes(extent) || buffer.byteLength !== bytes) throw new Error("lights of another length than they say");
  let next = floats;
  const arrays = sizes.map((size) => new Float32Array(buffer, (next += 4 * size) - 4 * size, size));
  const [directions, irradiance, covariances, places, intensities, radii] = arrays, of = (array, k, size) => [...array.subarray(size * k, size * (k + 1))];
  const ids = new Float64Array(buffer, HEAD_BYTES, count + nearCount), from = [24, 32, 40].map((offset) => view.getFloat64(offset, true));
  const directional = Array.from({ length: count }, (_, k) => ({
    id: ids[k], direction: of(directions, k, 3), irradiance: of(irradiance, k, 3), ...(extent && { covariance: of(covariances, k, extent) }),
  }));
  const near = Array.from({ length: nearCount }, (_, k) => ({
    id: ids[count + k], at: of(places, k, 3), intensity: of(intensities, k, 3), radius: radii[k],
  }));
  const frame = { sequence: view.getFloat64(8, true), time_s: view.getFloat64(16, true), coverage: view.getUint8(3) ? "sphere" : "hemisphere" };
  return { ...frame, directional, near, lights: [...directional, ...near.map((light) => asDirectional(light, from))] };
}

// as_directional.py, without extents.
function asDirectional({ id, at, intensity, radius }, from) {
  const towards = at.map((value, k) => value - from[k]), distance = Math.hypot(...towards), reach = Math.max(distance, radius, MIN_DISTANCE_M);
  const direction = distance > 0 ? towards.map((value) => value / distance) : [0, 0, 1];
  return { id: (id % NEAR_IDS) + NEAR_IDS, direction, irradiance: intensity.map((value) => value / reach ** 2) };
}
