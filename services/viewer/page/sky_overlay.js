// What the tools of the sky draw over its disc: masks, virtual lamps, what is being drawn, and the cross that keys move.

import { placeFrom } from "/sky_geometry.js";

const CHOSEN = "#ffd08a", OTHER = "#fff", HANDLE = "#1a1206";

// radius: of the disc in pixels of the canvas; unit: pixels of the canvas in one of CSS.
export function drawTools(tools, c, radius, unit) {
  const pen = { c, radius, unit, coverage: tools.sky.coverage, span: tools.span };
  const isChosen = (kind, key) => tools.selected?.kind === kind && tools.selected.key === key;
  c.save();
  [c.lineJoin, c.lineCap] = ["round", "round"];
  tools.masks.forEach((mask, k) => drawMask(pen, mask, isChosen("masks", k)));
  for (const lamp of tools.lamps) {
    drawLamp(pen, lamp, isChosen("lamps", lamp.id));
    if (isChosen("lamps", lamp.id)) dot(pen, tools.rimOf(lamp), 5);
  }
  [c.strokeStyle, c.lineWidth] = [CHOSEN, 2 * unit];
  if (tools.drawing) drawUnfinished(pen, tools);
  if (tools.drag?.moved && tools.tool === "lamp") {
    const [x, y] = tools.drag.from;
    ring(pen, tools.drag.from, Math.hypot(tools.drag.at[0] - x, tools.drag.at[1] - y) * radius);
  }
  if (tools.cross) drawCross(pen, tools.cross);
  c.restore();
}

function drawMask({ c, radius, unit, coverage, span }, mask, chosen) {
  const places = mask.points.map((point) => placeFrom(point, coverage)), fill = mask.mode === "dark" ? "rgb(0 0 0 / 0.45)" : "rgb(255 255 255 / 0.16)";
  path({ c, radius }, places, !mask.width_deg);
  if (mask.width_deg) {
    [c.lineWidth, c.strokeStyle] = [(mask.width_deg / span) * radius, fill];
    c.stroke();
  } else {
    c.fillStyle = fill;
    c.fill("evenodd");
  }
  c.setLineDash(mask.mode === "dark" ? [] : [5 * unit, 4 * unit]);
  [c.lineWidth, c.strokeStyle] = [(chosen ? 2.4 : 1.6) * unit, chosen ? CHOSEN : OTHER];
  c.stroke();
  c.setLineDash([]);
  if (chosen) for (const place of places) dot({ c, radius, unit }, place, 4.5);
}

function drawLamp(pen, lamp, chosen) {
  const { c, radius, unit, coverage, span } = pen, place = placeFrom([lamp.azimuth_deg, lamp.elevation_deg], coverage);
  [c.strokeStyle, c.lineWidth] = [chosen ? CHOSEN : OTHER, (chosen ? 2.4 : 1.4) * unit];
  ring(pen, place, Math.max(6 * unit, (lamp.size_deg / 2 / span) * radius));
  c.beginPath();
  for (let k = 0; k < 8; k++) { // rays, which no light of the map has
    const [x, y] = [Math.cos((k * Math.PI) / 4) * unit, Math.sin((k * Math.PI) / 4) * unit];
    c.moveTo(place[0] * radius + 8 * x, place[1] * radius + 8 * y);
    c.lineTo(place[0] * radius + 12 * x, place[1] * radius + 12 * y);
  }
  c.stroke();
}

function drawUnfinished(pen, { drawing, tool, "brush-width": width }) {
  const { c, radius, unit, span } = pen;
  if (tool === "brush") [c.lineWidth, c.strokeStyle] = [(Number(width.value) / span) * radius, "rgb(255 208 138 / 0.55)"];
  path(pen, drawing, false);
  c.stroke();
  [c.lineWidth, c.strokeStyle] = [2 * unit, CHOSEN];
  if (tool === "polygon") for (const place of drawing) dot(pen, place, 4.5);
}

function drawCross({ c, radius, unit }, [x, y]) {
  c.beginPath();
  for (const [dx, dy] of [[10 * unit, 0], [0, 10 * unit]]) {
    c.moveTo(x * radius - dx, y * radius - dy);
    c.lineTo(x * radius + dx, y * radius + dy);
  }
  c.stroke();
}

function path({ c, radius }, places, closed) {
  c.beginPath();
  for (const [x, y] of places) c.lineTo(x * radius, y * radius);
  if (places.length === 1) c.lineTo(places[0][0] * radius + 0.01, places[0][1] * radius); // a line of no length has no ends to draw
  if (closed) c.closePath();
}

function ring({ c, radius }, [x, y], size) {
  c.beginPath();
  c.arc(x * radius, y * radius, size, 0, 2 * Math.PI);
  c.stroke();
}

function dot(pen, place, size) {
  pen.c.fillStyle = HANDLE;
  ring(pen, place, size * pen.unit);
  pen.c.fill();
}
