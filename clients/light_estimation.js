// The shape of WebXR's light estimation (XRLightProbe, XRLightEstimate) from vemlight's lights, for pages that were written for a phone's.
// https://www.w3.org/TR/webxr-lighting-estimation-1/ : y up, directions towards the light, spherical harmonics of order 2 in RGB.
import { watchLights } from "./lights.js";

// Real spherical harmonics, bands 0 to 2, of a unit vector (Sloan 2008): nine numbers.
export function basis(x, y, z) {
  return [
    0.28209479177387814,
    0.4886025119029199 * y, 0.4886025119029199 * z, 0.4886025119029199 * x,
    1.0925484305920792 * x * y, 1.0925484305920792 * y * z, 0.31539156525252005 * (3 * z * z - 1),
    1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y),
  ];
}

// {sphericalHarmonicsCoefficients: Float32Array(27), primaryLightDirection, primaryLightIntensity} of a decoded frame. Coefficients are the
// lights' radiance projected, RGB by RGB; the primary light is the one with the most luminance, its intensity its irradiance.
export function estimateFrom(frame) {
  const sums = new Float64Array(27);
  let most = -1, primary = -1;
  for (let k = 0; k < frame.count; k++) {
    const [x, y, z] = [frame.directions[3 * k], frame.directions[3 * k + 2], -frame.directions[3 * k + 1]];
    const [r, g, b] = frame.irradiance.subarray(3 * k, 3 * k + 3);
    basis(x, y, z).forEach((value, i) => {
      sums[3 * i] += r * value;
      sums[3 * i + 1] += g * value;
      sums[3 * i + 2] += b * value;
    });
    const luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    if (luminance > most) [most, primary] = [luminance, k];
  }
  const at = primary < 0 ? [0, 1, 0] : [frame.directions[3 * primary], frame.directions[3 * primary + 2], -frame.directions[3 * primary + 1]];
  const light = primary < 0 ? [0, 0, 0] : frame.irradiance.subarray(3 * primary, 3 * primary + 3);
  return {
    sphericalHarmonicsCoefficients: Float32Array.from(sums),
    primaryLightDirection: { x: at[0], y: at[1], z: at[2], w: 0 },
    primaryLightIntensity: { x: light[0], y: light[1], z: light[2], w: 1 },
  };
}

// In place of `session.requestLightProbe()`: a probe that dispatches "reflectionchange" with each frame, and whose `estimate()` stands for
// `xrFrame.getLightEstimate(probe)`, null before the first.
export class LightProbe extends EventTarget {
  constructor(address, options) {
    super();
    this.frame = null;
    this.end = watchLights(address, (frame) => {
      this.frame = frame;
      this.dispatchEvent(new Event("reflectionchange"));
    }, options);
  }

  estimate() {
    return this.frame && estimateFrom(this.frame);
  }
}
