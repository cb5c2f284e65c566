// The histogram in stops: how much of the sky lies at each luminance (bars), and how much of the light comes from there (line).

const EDGE = 8; // CSS pixels around
const LETTERS = 16; // for the numbers below

export function drawHistogram(canvas, { histogram, scale }) {
  const unit = devicePixelRatio, width = Math.round(canvas.clientWidth * unit), height = Math.round(canvas.clientHeight * unit);
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const c = canvas.getContext("2d"), style = getComputedStyle(canvas);
  c.clearRect(0, 0, width, height);
  const { area, light, first, step } = histogram;
  if (!area.length) return;
  const shift = Math.log2(scale ?? 1), edge = EDGE * unit, bottom = height - (EDGE + LETTERS) * unit;
  const wide = (width - 2 * edge) / area.length, high = bottom - edge, top = Math.max(...area, ...light);
  c.fillStyle = style.getPropertyValue("--on-dark");
  c.globalAlpha = 0.55;
  area.forEach((part, k) => c.fillRect(edge + k * wide, bottom - (high * part) / top, Math.max(wide - unit, 1), (high * part) / top));
  c.globalAlpha = 1;
  c.strokeStyle = "#f3b95f"; // on the dark room in both themes
  c.lineWidth = 2 * unit;
  c.beginPath();
  light.forEach((part, k) => c.lineTo(edge + (k + 0.5) * wide, bottom - (high * part) / top));
  c.stroke();

  c.font = `${11 * unit}px system-ui, sans-serif`;
  c.textAlign = "center";
  c.textBaseline = "top";
  const stops = area.length * step, every = Math.max(1, Math.ceil((stops * 46 * unit) / (width - 2 * edge)));
  for (let stop = Math.ceil(first + shift); stop <= first + shift + stops; stop++) {
    if (((stop % every) + every) % every) continue;
    const x = edge + ((stop - first - shift) / step) * wide;
    if (x < edge + 14 * unit || x > width - edge - 14 * unit) continue;
    c.fillRect(x, bottom, unit, 4 * unit);
    c.fillText(scale ? shortNumber(2 ** stop) : `${stop > 0 ? "+" : ""}${stop}`.replace("-", "−"), x, bottom + 5 * unit);
  }
}

export function shortNumber(value) {
  if (value >= 1e6) return `${Number((value / 1e6).toPrecision(2))}M`;
  if (value >= 1e3) return `${Number((value / 1e3).toPrecision(2))}k`;
  return `${Number(value.toPrecision(2))}`;
}
