// The page: one websocket, whose messages go to the sky, the picture, the figures and the controls.

import { BINARY_FEEDS } from "/constants.js";
import { Controls } from "/controls.js";
import { Fixtures } from "/fixtures.js";
import { Gizmo } from "/gizmo.js";
import { Graphs } from "/graphs.js";
import { filterWords, givenUp, whyFewerLights } from "/given_up.js";
import { Guide } from "/guide.js";
import { History } from "/history.js";
import { lightsFromBytes } from "/lights_from_bytes.js";
import { Meter } from "/meter.js";
import { Objects } from "/objects.js";
import { overallState } from "/overall_state.js";
import { PersistedControls } from "/persisted_controls.js";
import { Relit } from "/relit.js";
import { Sky } from "/sky.js";
import { SkyTools } from "/sky_tools.js";
import { Source } from "/source.js";
import { Timeline } from "/timeline.js";

const FEEDS = "summary,placed-lights.bin,levels,disc,picture,picture-state";
const RECONNECT_MS = 1000;
const GREW_MS = 5000; // a count of losses is coloured while it grows, and for so long after
const MEASURES = [ // of every service: those of wire.StatusMessage
  { name: "age_ms", label: "age", unit: "ms", meaning: "of its newest frame when it was done: time since its light was seen" },
  { name: "step_ms", label: "step", unit: "ms", meaning: "its own time for a frame, median" },
  { name: "dropped", label: "dropped", unit: "", meaning: "frames that were published for it and never arrived", is_loss: true },
  { name: "skipped", label: "skipped", unit: "", meaning: "frames passed over for newer ones, because it is slower than its input", is_loss: true },
  { name: "unwritten", label: "not written", unit: "", meaning: "frames that the disk refused, as a full one does", is_loss: true },
  { name: "restarts", label: "restarts", unit: "", meaning: "by the supervisor", is_loss: true },
  { name: "refused", label: "refused", unit: "", meaning: "messages that are not valid", is_loss: true },
];
const FORMATS = { ms: milliseconds, Hz: hertz, frames: fraction, "%": percent, "": whole };
const grown = new Map(); // of a loss: its last value and when that rose
const at = (id) => document.getElementById(id);
const sky = new Sky(at("disc"), at("light-facts"));
const controls = new Controls(notice);
const objects = new Objects((change) => controls.choose(change));
const fixtures = new Fixtures((change) => controls.choose(change));
const graphs = new Graphs();
const source = new Source((change) => controls.choose(change));
const timeline = new Timeline((change) => controls.choose(change));
const skyTools = new SkyTools(sky, (change) => controls.choose(change), notice);
const history = new History(applyAgain);
const persisted = new PersistedControls((control) => history.quietly(() => controls.choose(control)));
const gizmo = new Gizmo(objects, () => history.control.camera);
const relit = new Relit(() => history.control, () => objects.poses, (change) => controls.choose(change));
controls.onChoose = (change) => { history.record(change); gizmo.draw(); relit.redraw(); };
const meter = new Meter(sky);
const guide = new Guide();
const notices = new Map();
let picture = null;

function notice(about, text) {
  text ? notices.set(about, text) : notices.delete(about);
  at("notice").hidden = notices.size === 0;
  at("notice").textContent = [...notices.values()].join(" · ");
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws?feeds=${FEEDS}`);
  let shown = []; // feeds to be named at the next frame of the browser
  let kept = false; // whether a picture waits to be named until somebody looks at the server's
  relit.onMode = () => {
    if (!kept || relit.alone || socket.readyState !== WebSocket.OPEN) return;
    kept = false;
    socket.send("picture");
  };
  socket.binaryType = "arraybuffer";
  socket.onopen = () => notice("socket", "");
  socket.onmessage = async ({ data }) => {
    try {
      const name = typeof data === "string" ? takeText(JSON.parse(data), data.length) : await takeBytes(data);
      if (name === "picture" && relit.alone) return void (kept = true);
      if (shown.push(name) > 1) return;
      await new Promise(requestAnimationFrame); // a hidden page asks for nothing
      if (socket.readyState === WebSocket.OPEN) socket.send(shown.join(","));
      shown = [];
    } catch (error) {
      notice("message", `This page could not show a message: ${error.message}`);
    }
  };
  socket.onclose = async () => {
    showState(at("overall"), "lost", "viewer lost");
    document.body.classList.add("dim");
    notice("socket", (await tokenRefused()) ? "The viewer has a new token: open the address that it printed." : "The viewer does not answer; trying again …");
    setTimeout(connect, RECONNECT_MS);
  };
}

// Whether the viewer answers, but does not accept this page's token. A refused socket does not say why.
function tokenRefused() {
  return fetch("/healthz", { signal: AbortSignal.timeout(RECONNECT_MS) }).then((answer) => answer.status === 401, () => false);
}

// Text is a summary, a frame's levels, or how a picture was made. Returns the feed's name.
function takeText(message, bytes) {
  if (message.schema?.startsWith("vemlight.picture/")) {
    relit.takeState(message, bytes);
    return "picture-state";
  }
  if (message.schema?.startsWith("vemlight.levels/")) {
    fixtures.show(message);
    count("rig");
    return "levels";
  }
  document.body.classList.remove("dim");
  persisted.take(message);
  controls.take(message);
  objects.take(message);
  skyTools.take(message);
  history.take(message);
  relit.take(message);
  gizmo.take(message);
  fixtures.take(message);
  sky.takeNear(message.near_lights);
  source.take(message);
  timeline.take(message);
  graphs.take(message);
  meter.take(message);
  guide.take(message);
  showFigures(message);
  showCards(message);
  showCovers(message);
  return "summary";
}

// A choice that was made before is made again: undo and redo.
function applyAgain(change) {
  controls.choose(change);
  controls.inputAt = -Infinity;
  if ("poses" in change) objects.adopt(change.poses);
  skyTools.adopt(change);
}

// Bytes are a frame's lights, its sky or its picture. Returns the feed's name.
async function takeBytes(buffer) {
  const bytes = new Uint8Array(buffer);
  if (bytes[0] !== BINARY_FEEDS["placed-lights.bin"]) return takePicture(bytes);
  const frame = lightsFromBytes(buffer);
  takeLights(frame);
  relit.takeLights(frame, buffer.byteLength);
  return "placed-lights.bin";
}

function takeLights(frame) {
  sky.take(frame, performance.now());
  graphs.takeLights(frame);
  at("sky-facts").textContent = `${frame.lights.length} lights${skyTools.facts}`;
  at("disc").setAttribute("aria-label", `The sky seen from below with ${frame.lights.length} lights. ${at("light-facts").textContent}`);
}

async function takePicture(bytes) {
  const image = await createImageBitmap(new Blob([bytes.subarray(1)], { type: "image/jpeg" }));
  if (bytes[0] === BINARY_FEEDS.disc) {
    sky.show(image);
    count("disc");
    return "disc";
  }
  if (bytes[0] !== BINARY_FEEDS.picture) throw new Error(`unknown kind ${bytes[0]}`);
  const canvas = at("picture");
  if (canvas.width !== image.width || canvas.height !== image.height) {
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.parentElement.style.setProperty("--picture-ratio", `${image.width} / ${image.height}`);
  }
  canvas.getContext("2d").drawImage(image, 0, 0);
  picture?.close();
  picture = image;
  count("picture");
  return "picture";
}

// How many frames have been shown, for tests.
function count(id) {
  at(id).dataset.shown = Number(at(id).dataset.shown ?? 0) + 1;
}

function showState(pill, state, text) {
  if (pill.dataset.state !== state) pill.dataset.state = state;
  if (pill.textContent !== text) pill.textContent = text;
}

// Changes a text only where it is another one: a live region is read again at each change.
function say(id, text) {
  if (at(id).textContent !== text) at(id).textContent = text;
}

function showFigures(summary) {
  const of = byService(summary);
  at("rate").textContent = rate(of.renderer.rate_hz);
  at("latency").textContent = milliseconds(of.renderer.age_ms);
  const { delay_ms, delay_frames } = of.sampler.report ?? {};
  at("delay").textContent = delay_frames ? `${milliseconds(delay_ms)} · ${fraction(delay_frames)}` : milliseconds(delay_ms);
  at("missed").replaceChildren(...summary.services.flatMap((row, k) => {
    const missed = (row.dropped ?? 0) + (row.skipped ?? 0), number = document.createElement("span");
    number.textContent = whole(missed);
    number.classList.toggle("lost", grows(`missed ${row.service}`, missed));
    return [`${k ? " · " : ""}${row.service} `, number];
  }));
  at("scene-facts").textContent = passes(of.renderer.report) || (Number.isInteger(of.renderer.sequence) ? `frame ${of.renderer.sequence}` : "");
  showState(at("overall"), ...overallState(summary));
  say("count-effect", whyFewerLights(summary));
  say("filter-effect", filterWords(summary));
}

// How far a paused picture has come; empty where it is not paused.
function passes(report) {
  if (!report?.max_passes) return "";
  const error = report.pass_error_ratio ? `, error about ${Number((100 * report.pass_error_ratio).toPrecision(2))} %` : "";
  return `pass ${report.passes} of ${report.max_passes}${error}`;
}

function byService(summary) {
  return Object.fromEntries(summary.services.map((row) => [row.kind, row]));
}

function showCards(summary) {
  for (const row of summary.services) {
    const fields = [...MEASURES, ...(summary.report_fields[row.service] ?? [])];
    const card = at(`card-${row.service}`) ?? newCard(row, fields);
    card.dataset.state = row.state;
    showState(card.querySelector(".pill"), row.state, row.text);
    card.querySelector("output").textContent = rate(row.rate_hz);
    card.querySelector(".given-up").textContent = row.kind === "renderer" ? givenUp(summary) : "";
    for (const field of fields) {
      const cell = card.querySelector(`[data-key="${field.name}"]`), value = row.report?.[field.name] ?? row[field.name];
      cell.textContent = FORMATS[field.unit](value);
      cell.parentElement.hidden = ["", "%"].includes(field.unit) && !value; // what does not happen takes no room
      cell.classList.toggle("lost", Boolean(field.is_loss) && grows(`${field.name} ${row.service}`, value ?? 0));
    }
  }
}

// Whether a count has grown lately.
function grows(name, value) {
  const now = performance.now(), last = grown.get(name) ?? { value, at: -Infinity };
  if (value !== last.value) grown.set(name, { value, at: value > last.value ? now : -Infinity });
  else if (!grown.has(name)) grown.set(name, last);
  return now - grown.get(name).at < GREW_MS;
}

function newCard(row, fields) {
  const card = at("card").content.cloneNode(true).firstElementChild;
  card.id = `card-${row.service}`;
  card.querySelector("h3").textContent = row.service;
  card.querySelector("h3").title = row.publishes ?? "";
  for (const { name, label, meaning } of fields) {
    const pair = document.createElement("div"), term = document.createElement("dt"), value = document.createElement("dd");
    term.textContent = label;
    pair.title = meaning;
    value.dataset.key = name;
    pair.append(term, value);
    card.querySelector("dl").append(pair);
  }
  at("services").append(card);
  return card;
}

// Over the pictures: what is awaited, or why the picture does not change.
function showCovers(summary) {
  const of = byService(summary);
  cover("sky", of.fuse ?? of.capture, Boolean(sky.image), summary.control.paused);
  cover("scene", of.renderer, Boolean(picture), false);
}

function cover(id, row, hasFrame, paused) {
  const line = at(`${id}-cover`), still = !["live", "finished"].includes(row.state);
  line.hidden = hasFrame && !still && !paused;
  line.classList.toggle("empty", !hasFrame);
  line.dataset.state = hasFrame ? (still ? row.state : "paused") : "";
  at(id).classList.toggle("dim", hasFrame && still);
  if (!hasFrame) {
    line.textContent = row.state === "not seen" ? `waiting for ${row.service} … (${row.text}: ${Math.round(performance.now() / 1000)} s so far)` : `${row.service}: ${row.text} …`;
  } else {
    line.textContent = still ? `${row.service}: ${row.text}` : "paused at this frame";
  }
}

function rate(value) {
  return value === undefined ? "–" : value.toFixed(1);
}

function milliseconds(value) {
  if (value === undefined || value === null) return "–";
  if (value >= 1e4) return `${(value / 1e3).toFixed(0)} s`;
  return `${value < 9.95 ? value.toFixed(1) : value.toFixed(0)} ms`;
}

function hertz(value) {
  return value === undefined ? "–" : value > 0 ? `${value.toFixed(1)} Hz` : "none";
}

function fraction(value) {
  return value === undefined ? "–" : `${Number(value.toFixed(1))} frames`;
}

function percent(ratio) {
  return ratio === undefined ? "–" : `${Number((100 * ratio).toPrecision(2))} %`;
}

function whole(value) {
  return value === undefined || value === null ? "–" : Number(value.toFixed(3)).toLocaleString("en").replaceAll(",", "\u202f");
}

connect();
