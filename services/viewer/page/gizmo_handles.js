// The handles of a gizmo: where they lie in the picture, which is under the pointer, and what a drag of one does to a pose.
// A picture's places are in CSS pixels from its upper left corner; `frame` is { view, width, height }.

import { axesOf, cross, distance, dot, minus, plus, rayThrough, unit } from "/relit_camera.js";

const SIZE = 0.2; // of the picture's height: how long an axis is, at any distance
const ALONG = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const ARC_POINTS = 48;
const FLAT = 0.15; // cosine between the eye's direction and a plane below which dragging in the plane is too coarse: about 9 degrees
export const SNAP = { move: 0.1, turn: 15, scale: 0.1 }; // metres, degrees, times
const LIMIT_M = 1e6, LEAST_SCALE = 1e-3, MOST_SCALE = 1e3; // as the wire has them

// Where a point of the world is in the picture; null behind the eye.
export function placeOf({ view, width, height }, point) {
  const off = minus(point, view.from), [right, down, forward] = axesOf(view).map((axis) => dot(axis, off));
  if (forward <= 1e-6) return null;
  const focal = height / 2 / Math.tan((view.fov_y * Math.PI) / 360);
  return [width / 2 + (right / forward) * focal, height / 2 + (down / forward) * focal];
}

// The handles of a tool about a pose: [{ name, axis, points: lines of places }].
export function handlesOf(frame, tool, pose) {
  const middle = pose.position, centre = placeOf(frame, middle);
  if (!centre) return [];
  const length = SIZE * 2 * Math.tan((frame.view.fov_y * Math.PI) / 360) * dot(axesOf(frame.view)[2], minus(middle, frame.view.from));
  const line = (points) => points.map((point) => placeOf(frame, point)).filter(Boolean);
  if (tool === "move") {
    const axes = ALONG.map((axis, k) => ({ name: "xyz"[k], axis, points: line([middle, plus(middle, axis, length)]) }));
    return [...axes, { name: "level", axis: null, points: [centre] }];
  }
  if (tool === "turn") {
    return ALONG.map((axis, k) => {
      const [a, b] = [ALONG[(k + 1) % 3], ALONG[(k + 2) % 3]];
      const ring = [...Array(ARC_POINTS + 1).keys()].map((n) => (2 * Math.PI * n) / ARC_POINTS)
        .map((angle) => plus(plus(middle, a, 0.85 * length * Math.cos(angle)), b, 0.85 * length * Math.sin(angle)));
      return { name: "xyz"[k], axis, points: line(ring) };
    });
  }
  if (tool === "scale") {
    const [right, down] = axesOf(frame.view), corner = plus(plus(middle, right, 0.6 * length), down, -0.6 * length);
    return [{ name: "size", axis: null, points: line([middle, corner]) }];
  }
  return [];
}

// The handle within `reach` of a place, the nearest of several.
export function handleAt(handles, at, reach) {
  let best = null, least = reach;
  for (const handle of handles) {
    const ends = handle.points.length === 1 || handle.name === "size" ? [handle.points.at(-1)] : handle.points;
    const off = lineDistance(at, ends);
    if (off < least || (off < reach && handle.name === "level" && off < reach / 1.5)) [best, least] = [handle, off];
  }
  return best;
}

// The pose that a drag of a handle from one place to another leaves; with `snap` in steps.
export function dragged(frame, tool, handle, pose, from, to, snap) {
  if (tool === "move") return { ...pose, position: movedTo(frame, handle, pose.position, from, to, snap) };
  if (tool === "turn") return { ...pose, rotation: turnedTo(frame, handle, pose, from, to, snap) };
  const centre = placeOf(frame, pose.position), was = Math.hypot(...minus(from, centre)), now = Math.hypot(...minus(to, centre));
  return scaled(pose, was > 0 ? now / was : 1, snap);
}

export function scaled(pose, times, snap) {
  const scale = (pose.scale ?? 1) * times, stepped = snap ? Math.max(1, Math.round(scale / SNAP.scale)) * SNAP.scale : scale;
  return { ...pose, scale: Number(Math.min(MOST_SCALE, Math.max(LEAST_SCALE, stepped)).toPrecision(5)) };
}

export function moved(position, step) {
  return plus(position, step).map((value) => Number(Math.min(LIMIT_M, Math.max(-LIMIT_M, value)).toFixed(4)));
}

// Turned by degrees about an axis of the world.
export function turned(rotation, axis, degrees) {
  const half = (degrees * Math.PI) / 360, [x, y, z] = axis.map((value) => value * Math.sin(half)), w = Math.cos(half), [a, b, c, d] = rotation;
  const made = [w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c];
  return made.map((value) => value / Math.hypot(...made));
}

function movedTo(frame, handle, position, from, to, snap) {
  const rays = [from, to].map((place) => rayThrough(frame.view, frame.width, frame.height, ...place));
  const snapped = (value) => (snap ? Math.round(value / SNAP.move) * SNAP.move : value);
  if (handle.axis) {
    const [was, now] = rays.map((ray) => alongAxis(ray, position, handle.axis)), k = handle.axis.indexOf(1);
    return moved(position, handle.axis.map((value) => value * (snapped(position[k] + now - was) - position[k])));
  }
  // In the level plane through it, or where that is seen from its side in the one that faces the eye.
  const forward = axesOf(frame.view)[2], normal = Math.abs(unit(minus(position, frame.view.from))[2]) > FLAT ? [0, 0, 1] : forward;
  const [was, now] = rays.map((ray) => inPlane(ray, position, normal));
  return was && now ? moved(position, minus(plus(position, minus(now, was)).map(snapped), position)) : position;
}

function turnedTo(frame, handle, pose, from, to, snap) {
  const { position, rotation } = pose, facing = unit(minus(frame.view.from, position));
  let angle;
  if (Math.abs(dot(facing, handle.axis)) > FLAT) {
    const arms = [from, to].map((place) => inPlane(rayThrough(frame.view, frame.width, frame.height, ...place), position, handle.axis));
    if (!arms[0] || !arms[1]) return rotation;
    const [a, b] = arms.map((point) => unit(minus(point, position)));
    angle = Math.atan2(dot(cross(a, b), handle.axis), dot(a, b));
  } else { // the ring is seen from its side: a drag along it, a radian for its radius
    const across = cross(handle.axis, facing), [a, b] = [position, plus(position, unit(across), distance(frame.view) / 10)].map((point) => placeOf(frame, point));
    if (!a || !b) return rotation;
    const along = minus(b, a), length = Math.hypot(...along);
    angle = (dot(minus(to, from), along) / length / frame.height) * 2 * Math.PI;
  }
  const degrees = (angle * 180) / Math.PI;
  return turned(rotation, handle.axis, snap ? Math.round(degrees / SNAP.turn) * SNAP.turn : degrees);
}

// How far along an axis through a point a ray comes nearest to it.
function alongAxis({ from, to }, point, axis) {
  const d = unit(to), off = minus(point, from), b = dot(axis, d), level = 1 - b * b;
  return level < 1e-6 ? 0 : (b * dot(d, off) - dot(axis, off)) / level;
}

function inPlane({ from, to }, point, normal) {
  const t = dot(minus(point, from), normal) / dot(to, normal);
  return t > 0 && Number.isFinite(t) ? plus(from, to, t) : null;
}

function lineDistance(at, line) {
  let least = Infinity;
  line.forEach((end, k) => {
    const start = line[Math.max(0, k - 1)], along = minus(end, start), length = dot(along, along);
    const t = length ? Math.min(1, Math.max(0, dot(minus(at, start), along) / length)) : 0;
    least = Math.min(least, Math.hypot(...minus(at, plus(start, along, t))));
  });
  return least;
}
