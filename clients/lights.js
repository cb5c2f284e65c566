// The lights of a running vemlight in a web page: a socket that hands over the newest frame, and the decoder of its bytes.
// docs/clients.md has the layout. No packages; copy it beside your page.

const HEAD_BYTES = 24;

// A frame {sequence, timeS, coverage, count, ids, directions, irradiance, covariances}: typed arrays over `buffer` (an ArrayBuffer), z up,
// directions towards the light; covariances xx xy xz yy yz zz, or null for points. Throws for anything else.
export function decodeLights(buffer) {
  const view = new DataView(buffer);
  if (view.byteLength < HEAD_BYTES || view.getUint8(0) !== 3 || view.getUint8(1) !== 1) throw new Error("not lights in layout 1");
  const extent = view.getUint8(2);
  const count = view.getUint32(4, true);
  if (buffer.byteLength !== HEAD_BYTES + count * (32 + 4 * extent)) throw new Error("lights of another length than they say");
  const floats = HEAD_BYTES + 8 * count;
  return {
    sequence: view.getFloat64(8, true), timeS: view.getFloat64(16, true), coverage: view.getUint8(3) ? "sphere" : "hemisphere", count,
    ids: new Float64Array(buffer, HEAD_BYTES, count),
    directions: new Float32Array(buffer, floats, 3 * count),
    irradiance: new Float32Array(buffer, floats + 12 * count, 3 * count),
    covariances: extent === 6 ? new Float32Array(buffer, floats + 24 * count, 6 * count) : null,
  };
}

// Calls onFrame with each frame that comes from `address` ("ws://127.0.0.1:8080"), the newest only: the next one is asked for when onFrame is
// done. Connects again by itself. Returns a function that ends it.
export function watchLights(address, onFrame, { token = "", onState = () => {} } = {}) {
  let socket = null, ended = false;
  const open = () => {
    if (ended) return;
    socket = new WebSocket(`${address}/ws?feeds=lights.bin${token ? `&token=${encodeURIComponent(token)}` : ""}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => onState("connected");
    socket.onmessage = ({ data }) => {
      onFrame(decodeLights(data));
      socket.send("lights.bin");
    };
    socket.onclose = () => {
      onState("closed");
      setTimeout(open, 1000);
    };
  };
  open();
  return () => {
    ended = true;
    socket.close();
  };
}
