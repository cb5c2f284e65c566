// The scene as the renderer flattened it: fetched once for each hash, which the browser keeps, and what a ray meets in it.
//
// loadScene() -> { hash, description, arrays, objects, cameras, bounds }; a camera is a view (relit_camera.js) and its name. An entry of `objects` is a mesh; several may be of one object, and then have
// its name. Its positions and normals stand in the world where the scene file has them ("at rest"); worldFromRest() says where they are now.

const VERTEX_NUMBERS = { positions: 3, normals: 3, uvs: 2, colours: 4, second_uvs: 2 };
const ARRAYS = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array };

let kept = null; // the newest scene, for all who ask on this page

// Rejects with an Error whose message is a line for the person, where there is no scene for browsers.
export async function loadScene() {
  const answer = await fetch("/scene.json");
  if (!answer.ok) throw new Error((await answer.text()).trim());
  const description = await answer.json(), { hash } = description;
  if (kept?.hash !== hash) kept = { hash, scene: fetched(description) };
  return kept.scene.catch((error) => { kept = null; throw error; });
}

async function fetched(description) {
  const data = await fetch(`/scene/${description.hash}.bin`);
  if (!data.ok) throw new Error((await data.text()).trim());
  return sceneOf(description, await data.arrayBuffer());
}

export function sceneOf(description, buffer) {
  const view = ({ offset, count, type }) => new ARRAYS[type](buffer, offset, count);
  const arrays = Object.fromEntries(Object.entries(description.arrays).map(([name, span]) => [name, view(span)]));
  const objects = description.meshes.map((mesh) => {
    const part = (name) => {
      const numbers = VERTEX_NUMBERS[name], first = mesh.vertices.first * numbers;
      return arrays[name]?.subarray(first, first + mesh.vertices.count * numbers);
    };
    const pose = mesh.object === null ? null : description.objects[mesh.object];
    const positions = part("positions");
    return {
      name: pose?.name ?? null, // null: it cannot be moved
      object: mesh.object,
      positions,
      normals: part("normals"),
      indices: arrays.indices.subarray(mesh.indices.first, mesh.indices.first + mesh.indices.count),
      material: description.materials[mesh.material],
      world_from_object: pose ? matrixOfPose(pose) : identity(),
      box: boxOf(positions),
    };
  });
  const cameras = [description.camera, ...description.views].map(({ name, view }) => ({ name, ...view }));
  const [low, high] = [0, 1].map((side) => description.centre.map((middle, k) => middle + (side ? 1 : -1) * description.half[k]));
  return { hash: description.hash, description, buffer, arrays, objects, cameras, bounds: { low, high } };
}

// For each mesh where it is now: 16 numbers, column by column, or null where it has not moved. poses: [{ name, position, rotation }], of any objects.
export function worldFromRest(scene, poses) {
  const asked = new Map((poses ?? []).map((pose) => [pose.name, pose]));
  const moved = scene.description.objects.map((rest) => {
    const now = asked.get(rest.name);
    if (!now || sameNumbers(placeNumbers(now), placeNumbers(rest))) return null;
    return multiplied(matrixOfPose(now), inverseOf(matrixOfPose(rest)));
  });
  return scene.objects.map((mesh) => (mesh.object === null ? null : moved[mesh.object]));
}

// The nearest surface on a ray { from, to }: of { mesh, name, distance, at, normal }, in lengths of the ray; null where it meets none.
export function pick(scene, poses, ray) {
  let best = null;
  worldFromRest(scene, poses).forEach((matrix, k) => {
    const mesh = scene.objects[k], back = matrix ? inverseOf(matrix) : null;
    const from = back ? transformed(back, ray.from, 1) : ray.from, to = back ? transformed(back, ray.to, 0) : ray.to;
    if (!meetsBox(mesh.box, from, to)) return;
    const hit = nearestTriangle(mesh, from, to, best?.distance ?? Infinity);
    if (!hit) return;
    const turned = matrix ? transformed(matrix, hit.normal, 0) : hit.normal, normal = turned.map((value) => value / Math.hypot(...turned));
    best = { mesh: k, name: mesh.name, distance: hit.distance, at: ray.from.map((value, axis) => value + hit.distance * ray.to[axis]), normal };
  });
  return best;
}

// Moeller and Trumbore 1997, both sides of each triangle.
function nearestTriangle({ positions, indices }, from, to, limit) {
  let distance = limit, found = -1;
  for (let t = 0; t < indices.length; t += 3) {
    const a = 3 * indices[t], b = 3 * indices[t + 1], c = 3 * indices[t + 2];
    const ax = positions[a], ay = positions[a + 1], az = positions[a + 2];
    const ux = positions[b] - ax, uy = positions[b + 1] - ay, uz = positions[b + 2] - az;
    const vx = positions[c] - ax, vy = positions[c + 1] - ay, vz = positions[c + 2] - az;
    const px = to[1] * vz - to[2] * vy, py = to[2] * vx - to[0] * vz, pz = to[0] * vy - to[1] * vx;
    const det = ux * px + uy * py + uz * pz;
    if (det === 0) continue;
    const sx = from[0] - ax, sy = from[1] - ay, sz = from[2] - az, u = (sx * px + sy * py + sz * pz) / det;
    if (!(u >= 0 && u <= 1)) continue;
    const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
    const v = (to[0] * qx + to[1] * qy + to[2] * qz) / det, along = (vx * qx + vy * qy + vz * qz) / det;
    if (v >= 0 && u + v <= 1 && along > 0 && along < distance) [distance, found] = [along, t];
  }
  if (found < 0) return null;
  const [a, b, c] = [0, 1, 2].map((k) => [0, 1, 2].map((axis) => positions[3 * indices[found + k] + axis]));
  const u = b.map((value, k) => value - a[k]), v = c.map((value, k) => value - a[k]);
  const facing = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const side = facing.reduce((sum, value, k) => sum + value * to[k], 0) > 0 ? -1 : 1, length = side * Math.hypot(...facing);
  return { distance, normal: facing.map((value) => value / length) };
}

function meetsBox([low, high], from, to) {
  let near = 0, far = Infinity;
  for (let k = 0; k < 3; k++) {
    const a = (low[k] - from[k]) / to[k], b = (high[k] - from[k]) / to[k];
    if (Number.isNaN(a) || Number.isNaN(b)) continue; // along a face
    near = Math.max(near, Math.min(a, b));
    far = Math.min(far, Math.max(a, b));
  }
  return near <= far;
}

export function boxOf(positions) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < positions.length; k++) {
    low[k % 3] = Math.min(low[k % 3], positions[k]);
    high[k % 3] = Math.max(high[k % 3], positions[k]);
  }
  return [low, high];
}

export function boxCorners([low, high]) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map((n) => [0, 1, 2].map((k) => ((n >> k) & 1 ? high[k] : low[k])));
}

export function identity() {
  return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
}

export function matrixOfPose({ position: [px, py, pz], rotation: [x, y, z, w] = [0, 0, 0, 1], scale = 1 }) {
  return new Float32Array([
    scale * (1 - 2 * (y * y + z * z)), scale * 2 * (x * y + z * w), scale * 2 * (x * z - y * w), 0,
    scale * 2 * (x * y - z * w), scale * (1 - 2 * (x * x + z * z)), scale * 2 * (y * z + x * w), 0,
    scale * 2 * (x * z + y * w), scale * 2 * (y * z - x * w), scale * (1 - 2 * (x * x + y * y)), 0,
    px, py, pz, 1,
  ]);
}

function placeNumbers({ position, rotation = [0, 0, 0, 1], scale = 1 }) {
  return [...position, ...rotation, scale];
}

export function multiplied(a, b) {
  const made = new Float32Array(16);
  for (let col = 0; col < 4; col++) for (let row = 0; row < 4; row++) {
    for (let k = 0; k < 4; k++) made[4 * col + row] += a[4 * k + row] * b[4 * col + k];
  }
  return made;
}

// Of a matrix that turns, scales evenly and moves.
export function inverseOf(m) {
  const made = identity(), square = m[0] * m[0] + m[1] * m[1] + m[2] * m[2];
  for (let col = 0; col < 3; col++) for (let row = 0; row < 3; row++) made[4 * col + row] = m[4 * row + col] / square;
  for (let row = 0; row < 3; row++) made[12 + row] = -(m[4 * row] * m[12] + m[4 * row + 1] * m[13] + m[4 * row + 2] * m[14]);
  return made;
}

// A point (w = 1) or a direction (w = 0) under a matrix.
export function transformed(m, [x, y, z], w) {
  return [0, 1, 2].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + w * m[12 + row]);
}

function sameNumbers(a, b) {
  return a.every((value, k) => value === b[k]);
}
