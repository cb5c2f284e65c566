// From where the scene is seen: a view is { from, at, fov_y }, as `camera` of a control has it. Functions make a new one of an old one.

const STEEPEST = Math.sin((89 * Math.PI) / 180); // straight up and down a view has no right and left of its own
const MAX_DEPTH_RATIO = 100000, DEPTH_MARGIN = 0.01, MIN_FAR_M = 1e-6; // view.py
const LIMIT_M = 1e6; // wire.Metres

export const minus = (a, b) => a.map((value, k) => value - b[k]);
export const plus = (a, b, times = 1) => a.map((value, k) => value + times * b[k]);
export const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
export const unit = (a) => a.map((value) => value / Math.hypot(...a));

// The axes right, down and forward: view_from_world of view.py.
export function axesOf({ from, at }) {
  const forward = unit(minus(at, from)), up = Math.abs(forward[2]) < 1 - 1e-9 ? [0, 0, 1] : [0, 1, 0];
  const right = unit(cross(forward, up));
  return [right, cross(forward, right), forward];
}

// Turns about what is looked at, in rad: across to the right, and up.
export function orbit(view, across, up) {
  const off = minus(view.from, view.at), length = Math.hypot(...off);
  const azimuth = Math.atan2(off[1], off[0]) - across;
  const height = Math.min(Math.max(Math.asin(off[2] / length) + up, -Math.asin(STEEPEST)), Math.asin(STEEPEST));
  const level = length * Math.cos(height);
  return bounded({ ...view, from: plus(view.at, [level * Math.cos(azimuth), level * Math.sin(azimuth), length * Math.sin(height)]) });
}

// Looks around from where the eye is, in rad.
export function look(view, across, up) {
  const turned = orbit({ ...view, from: view.at, at: view.from }, across, -up);
  return bounded({ ...view, at: turned.from });
}

// Moves eye and aim together, metres along right, down and forward.
export function travel(view, right, down, forward) {
  const axes = axesOf(view), step = [right, down, forward].reduce((sum, length, k) => plus(sum, axes[k], length), [0, 0, 0]);
  return bounded({ ...view, from: plus(view.from, step), at: plus(view.at, step) });
}

// Nearer to what is looked at, by a factor of its distance.
export function zoom(view, times) {
  const off = minus(view.from, view.at), length = Math.max(Math.hypot(...off) * times, 1e-3);
  return bounded({ ...view, from: plus(view.at, unit(off), Math.min(length, LIMIT_M / 4)) });
}

export function distance(view) {
  return Math.hypot(...minus(view.from, view.at));
}

function bounded(view) {
  const inside = (point) => point.map((value) => Math.min(Math.max(value, -LIMIT_M), LIMIT_M));
  return { from: inside(view.from), at: inside(view.at), fov_y: view.fov_y };
}

// 9 numbers, column by column, from (x, y, 1) in a picture with row 0 on top to the world direction seen there: view.py.
export function rayFromPixel(view, width, height) {
  const tall = Math.tan((view.fov_y * Math.PI) / 360), wide = (tall * width) / height, [right, down, forward] = axesOf(view);
  const x = right.map((value) => (value * 2 * wide) / width), y = down.map((value) => (value * 2 * tall) / height);
  return [...x, ...y, ...plus(plus(forward, right, -wide), down, -tall)];
}

// The ray { from, to } through a place in the picture, pixels.
export function rayThrough(view, width, height, x, y) {
  const m = rayFromPixel(view, width, height);
  return { from: view.from, to: [0, 1, 2].map((k) => m[k] * x + m[3 + k] * y + m[6 + k]) };
}

// 16 numbers, column by column: clip_from_world of view.py. corners: of the scene's box; nearest: no surface is nearer, metres.
export function clipFromWorld(view, width, height, corners, nearest) {
  const axes = axesOf(view), tall = 1 / Math.tan((view.fov_y * Math.PI) / 360), wide = (tall * height) / width;
  const depths = corners.map((corner) => dot(minus(corner, view.from), axes[2]));
  const far = Math.max(Math.max(...depths) * (1 + DEPTH_MARGIN), MIN_FAR_M);
  const least = nearest / Math.sqrt(1 + 1 / tall ** 2 + 1 / wide ** 2);
  const near = Math.max(Math.max(Math.min(...depths), least) * (1 - DEPTH_MARGIN), far / MAX_DEPTH_RATIO);
  const a = (far + near) / (far - near), b = (-2 * far * near) / (far - near), offsets = axes.map((axis) => -dot(axis, view.from));
  const rows = [
    [...axes[0].map((value) => wide * value), wide * offsets[0]],
    [...axes[1].map((value) => tall * value), tall * offsets[1]],
    [...axes[2].map((value) => a * value), a * offsets[2] + b],
    [...axes[2], offsets[2]],
  ];
  return [0, 1, 2, 3].flatMap((col) => rows.map((row) => row[col]));
}

// How far the nearest of boxes [low, high] is from a place.
export function nearestDistance(from, boxes) {
  const off = ([low, high]) => Math.hypot(...from.map((value, k) => Math.max(low[k] - value, value - high[k], 0)));
  return Math.min(...boxes.map(off));
}
