// A frame's lights from the bytes of the feed lights.bin, as objects like those of `vemlight.lights/2`; docs/clients.md has the layout.

const HEAD_BYTES = 24;

export function lightsFromBytes(buffer) {
  const view = new DataView(buffer), extent = view.getUint8(2), count = view.getUint32(4, true);
  if (view.getUint8(1) !== 1 || buffer.byteLength !== HEAD_BYTES + count * (32 + 4 * extent)) throw new Error("lights in a layout that is not known");
  const floats = HEAD_BYTES + 8 * count, of = (array, k, size) => [...array.subarray(size * k, size * (k + 1))];
  const ids = new Float64Array(buffer, HEAD_BYTES, count), numbers = (offset, size) => new Float32Array(buffer, floats + offset * count, size * count);
  const directions = numbers(0, 3), irradiance = numbers(12, 3), covariances = extent ? numbers(24, extent) : null;
  const lights = Array.from({ length: count }, (_, k) => ({
    id: ids[k], direction: of(directions, k, 3), irradiance: of(irradiance, k, 3), ...(covariances && { covariance: of(covariances, k, extent) }),
  }));
  return { sequence: view.getFloat64(8, true), time_s: view.getFloat64(16, true), coverage: view.getUint8(3) ? "sphere" : "hemisphere", lights };
}
