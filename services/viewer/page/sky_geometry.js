// The disc of the sky: directions as azimuth and elevation in degrees, places as x to the right and y down in parts of the disc's radius.
// The zenith is in the middle, +Y at the top, +X at the left; the angle from the zenith is proportional to the radius.

export const spanOf = (coverage) => (coverage === "sphere" ? 180 : 90); // degrees from the middle to the rim

export function placeFrom([azimuth, elevation], coverage) {
  const r = (90 - elevation) / spanOf(coverage), phi = (azimuth * Math.PI) / 180;
  return [-r * Math.cos(phi), -r * Math.sin(phi)];
}

// To hundredths of a degree; beyond the rim as far as angles go.
export function directionFrom([x, y], coverage) {
  const azimuth = ((Math.atan2(-y, -x) * 180) / Math.PI + 360) % 360, angle = Math.min(180, Math.hypot(x, y) * spanOf(coverage));
  return [hundredths(azimuth), hundredths(90 - angle)];
}

export function hundredths(value) {
  return Math.round(100 * value) / 100;
}

// Whether a place is in a polygon of places, by the even-odd rule, as the capture fills it.
export function isInside([x, y], polygon) {
  let inside = false;
  polygon.forEach(([x1, y1], k) => {
    const [x0, y0] = polygon.at(k - 1);
    if (y0 > y !== y1 > y && x < x0 + ((y - y0) / (y1 - y0)) * (x1 - x0)) inside = !inside;
  });
  return inside;
}

// How far a place is from a line of places.
export function distanceTo([x, y], line) {
  let least = Infinity;
  line.forEach(([x1, y1], k) => {
    const [x0, y0] = line[Math.max(0, k - 1)], dx = x1 - x0, dy = y1 - y0, length = dx * dx + dy * dy;
    const t = length ? Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / length)) : 0;
    least = Math.min(least, Math.hypot(x - x0 - t * dx, y - y0 - t * dy));
  });
  return least;
}

// As few points of a line as stay within `tolerance` of it (Douglas and Peucker 1973), at most `most`.
export function simplified(line, tolerance, most) {
  const kept = within(line, tolerance);
  return kept.length > most ? simplified(line, 1.5 * tolerance, most) : kept;
}

function within(line, tolerance) {
  let far = 0, at = 0;
  for (let k = 1; k < line.length - 1; k++) {
    const distance = distanceTo(line[k], [line[0], line.at(-1)]);
    if (distance > far) [far, at] = [distance, k];
  }
  if (far <= tolerance) return line.length > 1 ? [line[0], line.at(-1)] : line;
  return [...within(line.slice(0, at + 1), tolerance).slice(0, -1), ...within(line.slice(at), tolerance)];
}

// The mark of a near light, as a path about a place; whoever calls it strokes it.
export function traceDiamond(c, x, y, r) {
  c.beginPath();
  for (const [dx, dy] of [[0, -r], [r, 0], [0, r], [-r, 0]]) c.lineTo(x + dx, y + dy);
  c.closePath();
}
