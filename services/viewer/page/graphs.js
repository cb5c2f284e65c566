// Graphs of the last minutes, drawn on canvases: rings of numbers that take no more memory the longer the page is open.

import { grouped } from "/numbers.js";

const PERIOD_MS = 500, SAMPLES = 600; // five minutes; 11 series of 600 doubles have 53 kB
const SHORTEST = 120; // samples: a page that was just opened shows a minute, and more as it comes
const TABLE_MS = 2000; // the table changes so often: faster than that nobody reads it
const NARROW = 640; // CSS pixels, as in viewer.css
const TICKS = [1, 2, 5]; // times a power of ten: where an axis ends
const at = (id) => document.getElementById(id);

// of: the value now, or undefined where there is none. Colours are variables of the page, so that both themes have their own.
const GRAPHS = [
  { title: "rate", unit: "/s", series: [
    { label: "pictures", colour: "--light", of: ({ renderer }) => renderer?.rate_hz },
    { label: "maps", colour: "--waiting", of: ({ fuse, capture }) => (fuse ?? capture)?.rate_hz }] },
  { title: "age of pictures", unit: "ms", series: [
    { label: "p50", colour: "--light", of: (_, summary) => summary.age?.p50_ms },
    { label: "p99", colour: "--bad", of: (_, summary) => summary.age?.p99_ms }] },
  { title: "lights", unit: "", series: [
    { label: "drawn", colour: "--light", of: ({ renderer }) => renderer?.report?.drawn_lights },
    { label: "required", colour: "--waiting", of: ({ sampler }) => sampler?.report?.required_lights || undefined }] },
  { title: "power", unit: "", series: [{ label: "irradiance of all lights, luminance", colour: "--light", of: (_s, _m, power) => power }] },
  { title: "flicker depth", unit: "%", series: [{ label: "amplitude over mean", colour: "--light", of: ({ sampler }) => percent(sampler?.report?.flicker_depth) }] },
  { title: "error", unit: "%", series: [
    { label: "estimated", colour: "--light", of: ({ sampler }) => percent(sampler?.report?.error_ratio || undefined) },
    { label: "promised at most", colour: "--bad", of: ({ sampler }) => percent(sampler?.report?.error_limit_ratio || undefined) }] },
];

export class Graphs {
  constructor() {
    this.series = GRAPHS.flatMap((graph) => graph.series.map(() => new Float64Array(SAMPLES).fill(NaN)));
    this.next = 0; // where in the rings the next sample goes
    this.taken = 0;
    this.power = undefined; // of the newest lights
    this.sampledAt = this.tableAt = -Infinity;
    this.cursor = null; // samples before the newest
    this.panel = at("graphs");
    this.panel.open = innerWidth > NARROW; // on a phone they are long: they open when somebody wants them
    this.graphs = GRAPHS.map((graph, n) => this.build(graph, n));
    this.panel.addEventListener("toggle", () => this.draw());
    at("graphs-figures").addEventListener("toggle", () => this.fillTable());
    new ResizeObserver(() => this.draw()).observe(this.panel);
    document.addEventListener("themechange", () => this.draw());
  }

  build(graph, n) {
    const box = document.createElement("figure"), title = document.createElement("figcaption"), values = document.createElement("span"), frame = document.createElement("div");
    const canvas = document.createElement("canvas");
    box.className = "graph";
    values.className = "facts";
    frame.className = "plot";
    title.append(graph.title, values);
    Object.assign(canvas, { tabIndex: 0, id: `graph-${n}` });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${graph.title} over the last minutes; left and right arrows give values, the table below has them, too`);
    frame.append(canvas);
    box.append(title, frame);
    at("graph-boxes").append(box);
    canvas.addEventListener("pointermove", (event) => {
      const bounds = canvas.getBoundingClientRect();
      this.point(Math.round((1 - (event.clientX - bounds.left) / bounds.width) * (this.span - 1)));
    });
    canvas.addEventListener("pointerleave", () => this.point(null));
    canvas.addEventListener("blur", () => this.point(null));
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: 1, ArrowRight: -1, PageUp: 20, PageDown: -20 }[event.key];
      if (!by) return;
      event.preventDefault();
      this.point((this.cursor ?? 0) + by);
    });
    const first = GRAPHS.slice(0, n).reduce((sum, { series }) => sum + series.length, 0);
    return { ...graph, canvas, values, first };
  }

  // How many samples the graphs show.
  get span() {
    return Math.max(SHORTEST, this.taken);
  }

  point(back) {
    this.cursor = back === null ? null : Math.min(Math.max(0, this.taken - 1), Math.max(0, back));
    this.draw();
  }

  // Summaries come four times a second; every second one is a sample. What is not live has no value, and the line a gap.
  take(summary) {
    const now = performance.now();
    if (now - this.sampledAt < 0.75 * PERIOD_MS) return;
    this.sampledAt = now;
    const live = Object.fromEntries(summary.services.filter(({ state }) => state === "live").map((row) => [row.kind, row]));
    const values = GRAPHS.flatMap(({ series }) => series.map(({ of }) => of(live, summary, live.sampler ? this.power : undefined)));
    values.forEach((value, k) => { this.series[k][this.next] = value ?? NaN; });
    this.next = (this.next + 1) % SAMPLES;
    this.taken = Math.min(SAMPLES, this.taken + 1);
    if (this.cursor !== null && !this.panel.matches(":hover")) this.cursor = Math.min(SAMPLES - 1, this.cursor + 1);
    this.draw();
    if (now - this.tableAt > TABLE_MS) {
      this.tableAt = now;
      this.fillTable();
    }
  }

  // The value so many samples before the newest.
  value(k, back) {
    return this.series[k][(this.next - 1 - back + 2 * SAMPLES) % SAMPLES];
  }

  draw() {
    if (!this.panel.open) return;
    const style = getComputedStyle(document.documentElement);
    for (const graph of this.graphs) this.drawGraph(graph, (name) => style.getPropertyValue(name));
    at("graphs-when").textContent = this.cursor ? `${(this.cursor * PERIOD_MS / 1e3).toFixed(1)} s ago` : `the last ${Math.round(this.span * PERIOD_MS / 1e3)} s`;
  }

  drawGraph({ canvas, values, series, first, unit: name }, colour) {
    const unit = devicePixelRatio, width = Math.round(canvas.clientWidth * unit), height = Math.round(canvas.clientHeight * unit);
    if (!width) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const c = canvas.getContext("2d"), x = (back) => width * (1 - back / (this.span - 1)), top = axisEnd(this.greatest(first, series.length));
    const y = (value) => height - 2 * unit - ((height - 4 * unit) * value) / top;
    c.clearRect(0, 0, width, height);
    c.strokeStyle = colour("--line");
    c.lineWidth = unit;
    for (const part of [0, 0.5, 1]) {
      c.beginPath();
      c.moveTo(0, y(part * top));
      c.lineTo(width, y(part * top));
      c.stroke();
    }
    c.fillStyle = colour("--quiet");
    c.font = `${11 * unit}px system-ui, sans-serif`;
    c.textBaseline = "top";
    c.fillText(`${number(top)}${name && ` ${name}`}`, 3 * unit, 4 * unit);
    series.forEach((each, n) => {
      c.strokeStyle = c.fillStyle = colour(each.colour);
      c.lineWidth = 1.6 * unit;
      c.setLineDash(n ? [5 * unit, 3 * unit] : []); // told apart without colours, too
      c.beginPath();
      let open = false;
      for (let back = this.taken - 1; back >= 0; back--) {
        const value = this.value(first + n, back);
        if (Number.isNaN(value)) open = false;
        else open ? c.lineTo(x(back), y(value)) : c.moveTo(x(back), y(value)), (open = true);
      }
      c.stroke();
    });
    c.setLineDash([]);
    if (this.cursor !== null) {
      c.fillStyle = colour("--text");
      c.fillRect(x(this.cursor) - unit / 2, 0, unit, height);
    }
    const text = series.map((each, n) => `${series.length > 1 ? `${each.label} ` : ""}${number(this.value(first + n, this.cursor ?? 0))}`).join(" · ");
    values.textContent = `${text}${name && ` ${name}`}`;
  }

  greatest(first, count) {
    let most = 0;
    for (let k = first; k < first + count; k++) for (const value of this.series[k]) if (value > most) most = value;
    return most;
  }

  // For those who do not see the lines: newest, least, mean and greatest of each.
  fillTable() {
    const body = at("graphs-table").tBodies[0];
    if (!at("graphs-figures").open) return;
    body.replaceChildren(...this.graphs.flatMap(({ title, unit, series, first }) => series.map((each, n) => {
      const known = this.series[first + n].filter((value) => !Number.isNaN(value)), row = document.createElement("tr"), head = document.createElement("th");
      head.scope = "row";
      head.textContent = `${title}, ${each.label}${unit && `, ${unit}`}`;
      const mean = known.reduce((sum, value) => sum + value, 0) / known.length;
      const cells = [this.value(first + n, 0), Math.min(...known), mean, Math.max(...known)].map((value) => {
        const cell = document.createElement("td");
        cell.textContent = known.length ? number(value) : "–";
        return cell;
      });
      row.append(head, ...cells);
      return row;
    })));
  }
}

function percent(ratio) {
  return ratio === undefined ? undefined : 100 * ratio;
}

// The least of 1, 2 and 5 times a power of ten that is not below a value.
function axisEnd(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return (TICKS.find((tick) => tick * power >= value) ?? 10) * power;
}

function number(value) {
  if (Number.isNaN(value)) return "–";
  return Math.abs(value) >= 1000 ? grouped(Math.round(value)) : String(Number(value.toPrecision(3)));
}
