// Directional lights as the browser draws them: cut into points where they are soft, each with a shadow map of the resolution that it deserves and
// a place in the atlas. The laws are those of the renderer: extent.py, shadow_map_resolution.py, light_frames.comp.

import { LUMINANCE_WEIGHTS } from "/constants.js";
import { dot } from "/relit_camera.js";

// The strongest so many are drawn: as four points each they fill the 2048 rows that a texture of any WebGL2 has.
const MAX_DRAWN = 512;
const FLATTEST_BOX = 1e-4; // light_frames.comp

export function luminance(rgb) {
  return dot(rgb, LUMINANCE_WEIGHTS);
}

export function withPower(lights) {
  return lights.filter((light) => light.irradiance.some((value) => value !== 0));
}

// The strongest MAX_DRAWN of the lights.
export function strongest(lights) {
  return lights.length <= MAX_DRAWN ? lights : [...lights].sort((a, b) => luminance(b.irradiance) - luminance(a.irradiance)).slice(0, MAX_DRAWN);
}

// Soft lights as laws.POINTS points each, narrow ones as one: points_of_extents of extent.py. Mirrors show each as wide as its light: reflected_light.py.
export function pointsOf(lights, laws) {
  return lights.flatMap((light) => {
    if (!light.covariance) return [light];
    const [xx, xy, xz, yy, yz, zz] = light.covariance, trace = Math.min(Math.max(xx + yy + zz, 0), 1), id = laws.POINTS * light.id;
    const variance = trace / 2;
    if (Math.sqrt(variance) < laws.DIVIDED_RAD) return [{ ...light, id, variance }];
    const full = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    const [first, second] = tangents(light.direction), across = (a, b) => dot(a, full.map((row) => dot(row, b)));
    const axes = principalAxes(across(first, first), across(first, second), across(second, second)).map(([x, y, size]) =>
      first.map((value, k) => Math.SQRT2 * size * (x * value + y * second[k])));
    const irradiance = light.irradiance.map((value) => value / laws.POINTS), middle = light.direction.map((value) => value * Math.sqrt(1 - trace));
    return [[1, 0], [0, 1], [-1, 0], [0, -1]].map(([a, b], k) => {
      const place = middle.map((value, axis) => value + a * axes[0][axis] + b * axes[1][axis]), length = Math.hypot(...place);
      return { id: id + k, direction: place.map((value) => value / length), irradiance, variance };
    });
  });
}

// Unit eigenvectors of [[a, b], [b, c]] with the roots of their eigenvalues, the smaller first.
function principalAxes(a, b, c) {
  const middle = (a + c) / 2, half = Math.hypot((a - c) / 2, b), angle = 0.5 * Math.atan2(2 * b, a - c);
  const large = [Math.cos(angle), Math.sin(angle), Math.sqrt(Math.max(middle + half, 0))];
  return [[-large[1], large[0], Math.sqrt(Math.max(middle - half, 0))], large];
}

// Two axes across a unit vector (Duff et al. 2017).
function tangents([x, y, z]) {
  const s = z < 0 ? -1 : 1, a = -1 / (s + z);
  return [[1 + s * x * x * a, s * x * y * a, -s * x], [x * y * a, s + y * y * a, -y]];
}

// How often the map of each light is halved: map_halvings. previous: of the last frame by id.
export function mapHalvings(lights, laws, previous) {
  const near = laws.BY_POWER ? nearFractions(lights, laws) : null, most = laws.MAP_HALVINGS;
  return lights.map((light, i) => {
    let exact = near ? Infinity : 0;
    for (let k = 0; near && k <= most; k++) {
      exact = Math.min(exact, Math.max(-laws.EXPONENT * Math.log2(Math.max(near[i * (most + 1) + k], 1e-9) / laws.FULL_FRACTION), k));
    }
    exact = Math.min(Math.max(exact, 0), most);
    const before = previous?.get(light.id);
    return before !== undefined && Math.abs(exact - before) <= 0.5 + laws.HYSTERESIS ? before : Math.floor(exact + 0.5);
  });
}

// For each light and choice of resolution the fraction of the power whose shadows are the same there. Of pairs of lights most are far apart.
function nearFractions(lights, laws) {
  const choices = laws.MAP_HALVINGS + 1, powers = lights.map((light) => luminance(light.irradiance)), total = powers.reduce((a, b) => a + b, 0);
  const least = Array.from({ length: choices }, (_, k) => 1 - ((laws.SAME_SHADOW_TEXELS * 2 ** k) / laws.LARGEST_MAP) ** 2 / 2);
  const all = Float64Array.from(lights.flatMap((light) => light.direction)), near = new Float64Array(lights.length * choices);
  for (let i = 0; i < lights.length; i++) {
    const x = all[3 * i], y = all[3 * i + 1], z = all[3 * i + 2];
    for (let j = 0; j < lights.length; j++) {
      const cosine = x * all[3 * j] + y * all[3 * j + 1] + z * all[3 * j + 2];
      for (let k = choices - 1; k >= 0 && cosine > least[k]; k--) near[i * choices + k] += powers[j] / total;
    }
  }
  return near;
}

// Square tiles in rows of equal ones, the largest first: { corners, width, height }, or null where they do not fit. sizes: the largest first.
export function packed(sizes, maxSide) {
  if (!sizes.length) return { corners: [], width: 1, height: 1 };
  const texels = sizes.reduce((sum, size) => sum + size * size, 0);
  for (let width = 2 ** Math.ceil(Math.log2(Math.max(sizes[0], Math.sqrt(texels)))); width <= maxSide; width *= 2) {
    const corners = [];
    let y = 0, column = 0;
    sizes.forEach((size, k) => {
      if (k && (size !== sizes[k - 1] || column + size > width)) [y, column] = [y + sizes[k - 1], 0];
      corners.push([column, y]);
      column += size;
    });
    y += sizes.at(-1);
    const part = Math.max(width / 4, 1);
    if (y <= maxSide) return { corners, width, height: Math.min(Math.ceil(y / part) * part, maxSide) };
  }
  return null;
}

// Writes the frame of a light into 4 numbers a texel, from `at` on: light_frames.comp. map: { direction, resolution, corner, number }.
export function writeFrame(numbers, at, light, map, box, laws) {
  const d = map.direction, [right, up] = tangents(d), absolute = (axis) => dot(axis.map(Math.abs), box.half);
  const flattest = FLATTEST_BOX * (box.half[0] + box.half[1] + box.half[2]);
  const [wide, tall, deep] = [absolute(right) + flattest, absolute(up) + flattest, absolute(d) + flattest];
  const side = 0.5 * map.resolution - laws.GUTTER, sx = side / wide, sy = side / tall, sz = (-0.5 * laws.FARTHEST_DEPTH) / deep;
  const plane = (axis, scale, middle) => [...axis.map((value) => value * scale), middle - dot(axis, box.centre) * scale];
  const put = (name, values) => numbers.set(values, at + laws[`LIGHT_AT_${name}`]);
  put("column", plane(right, sx, 0.5 * map.resolution));
  put("row", plane(up, sy, 0.5 * map.resolution));
  put("depth", plane(d, sz, 0.5 * laws.FARTHEST_DEPTH));
  put("direction", light.direction);
  put("bias", [(-laws.SHADOW_BIAS_TEXELS * sz) / Math.min(sx, sy)]);
  put("irradiance", light.irradiance);
  put("map", [map.number]);
  put("corner", map.corner);
  put("slope", [-sz / (sx * sx), -sz / (sy * sy)]);
  put("resolution", [map.resolution]);
  put("spread", [0]); // soft lights are several points here
  put("concentration", [1]);
  put("lobe_spread", [light.spread ?? light.variance ?? 0]);
  put("least_width", [light.leastWidth ?? 0]);
  put("direct", [light.direct ?? 1]); // withReflection(), where there is a map
}

