// The page: one websocket, whose messages go to the sky, the picture, the figures and the controls.

import { BINARY_FEEDS, MAX_PAGES } from "/constants.js";
import { Controls } from "/controls.js";
import { Fixtures } from "/fixtures.js";
import { Gizmo } from "/gizmo.js";
import { Graphs } from "/graphs.js";
import { filterWords, givenUp, whyFewerLights } from "/given_up.js";
import { Guide } from "/guide.js";
import { History } from "/history.js";
import { lightsFromBytes } from "/lights_from_bytes.js";
import { Meter } from "/meter.js";
import { grouped } from "/numbers.js";
import { Objects } from "/objects.js";
import { overallState, rowState } from "/overall_state.js";
import { PersistedControls } from "/persisted_controls.js";
import { Relit } from "/relit.js";
import { Sky } from "/sky.js";
import { SkyTools } from "/sky_tools.js";
import { Source } from "/source.js";
import { Timeline } from "/timeline.js";

// environment.bin is asked for while this browser draws.
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
const FORMATS = { ms: milliseconds, Hz: hertz, frames: fraction, "%": percent, lux, "": whole }; // of the units that report_fields.py has
const FEED_OF_BYTE = Object.fromEntries(Object.entries(BINARY_FEEDS).map(([name, byte]) => [byte, name]));
const TAKE = { // by the name of a feed: what shows its message
  summary: takeSummary, levels: takeLevels, "picture-state": (state, bytes) => relit.takeState(state, bytes), "placed-lights.bin": takeLights, disc: takeDisc,
  picture: takePicture, "environment.bin": (buffer) => relit.takeEnvironment(buffer),
};
const failed = new Set(); // feeds whose newest frame could not be made
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
  say("notice", [...notices.values()].join(" · "));
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws?feeds=${FEEDS}`);
  let shown = []; // feeds to be named at the next frame of the browser
  const kept = new Set(["environment.bin"]); // feeds to be named when somebody looks at what they show
  const wanted = (name) => (name === "picture" ? !relit.alone : name !== "environment.bin" || relit.draws);
  relit.onMode = () => {
    const now = [...kept].filter(wanted);
    if (!now.length || socket.readyState !== WebSocket.OPEN) return;
    for (const name of now) kept.delete(name);
    socket.send(now.join(","));
  };
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { notice("socket", ""); relit.onMode(); };
  socket.onmessage = async ({ data }) => {
    const name = await take(data);
    if (!name) return;
    if (!wanted(name)) return void kept.add(name);
    if (shown.push(name) > 1) return;
    await new Promise(requestAnimationFrame); // a hidden page asks for nothing
    if (socket.readyState === WebSocket.OPEN) socket.send(shown.join(","));
    shown = [];
  };
  socket.onclose = async () => {
    showLost();
    notice("socket", await whyLost());
    setTimeout(connect, RECONNECT_MS);
  };
}

// Nothing is known any more: nothing is called live.
function showLost() {
  for (const pill of document.querySelectorAll(".pill[data-state]")) showState(pill, "lost", pill.id === "overall" ? "viewer lost" : "not known");
  [at("overall-said").dataset.kind, at("overall-said").textContent] = ["lost", "viewer lost"];
  for (const card of document.querySelectorAll("article")) card.dataset.state = "lost";
  document.body.classList.add("dim");
  meter.lose();
}

// A refused socket does not say why.
async function whyLost() {
  try {
    const answer = await fetch("/healthz", { signal: AbortSignal.timeout(RECONNECT_MS) });
    if (answer.status === 401) return "The viewer has a new token: open the address that it printed.";
    if ((await answer.json()).pages >= MAX_PAGES) return `${MAX_PAGES} pages are open, the most that the viewer takes: close one. Trying again …`;
  } catch { /* it is away, or not ready */ }
  return "The viewer does not answer; trying again …";
}

// Shows a message, and returns the name of its feed: what cannot be shown is said, and does not hold up what follows. Null for an unknown kind.
async function take(data) {
  const text = typeof data === "string" ? JSON.parse(data) : null, name = text ? feedOfText(text) : FEED_OF_BYTE[new Uint8Array(data, 0, 1)[0]] ?? null;
  try {
    if (!name) throw new Error("of an unknown kind");
    await TAKE[name](text ?? data, data.length);
    notice(`message ${name}`, "");
  } catch (error) {
    notice(`message ${name}`, `This page could not show a message (${name ?? "its kind"}): ${error.message}`);
  }
  return name;
}

function feedOfText({ schema }) {
  return schema?.startsWith("vemlight.picture/") ? "picture-state" : schema?.startsWith("vemlight.levels/") ? "levels" : "summary";
}

function takeLevels(levels) {
  fixtures.show(levels);
  count("rig");
}

function takeSummary(message) {
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
  showFailures(message.failures);
  showFigures(message);
  showCards(message);
  showCovers(message);
}

// What the viewer could not send: the page shows what was before.
function showFailures(failures) {
  for (const name of new Set([...failed, ...Object.keys(failures)])) {
    const reason = failures[name];
    notice(`feed ${name}`, reason ? `The viewer could not make ${name} (${reason}): what you see of it is older.` : "");
    reason ? failed.add(name) : failed.delete(name);
  }
}

// A choice that was made before is made again: undo and redo.
function applyAgain(change) {
  controls.choose(change);
  if ("poses" in change) objects.adopt(change.poses);
  skyTools.adopt(change);
  timeline.adopt(change);
}

function takeLights(buffer) {
  const frame = lightsFromBytes(buffer);
  relit.takeLights(frame, buffer.byteLength);
  sky.take(frame, performance.now());
  graphs.power = sky.power; // it counts until the next come
  say("sky-facts", `${frame.lights.length} lights${skyTools.facts}`);
}

function imageOf(buffer) {
  return createImageBitmap(new Blob([new Uint8Array(buffer, 1)], { type: "image/jpeg" }));
}

async function takeDisc(buffer) {
  sky.show(await imageOf(buffer));
  count("disc");
}

async function takePicture(buffer) {
  const image = await imageOf(buffer), canvas = at("picture");
  if (canvas.width !== image.width || canvas.height !== image.height) {
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.parentElement.style.setProperty("--picture-ratio", `${image.width} / ${image.height}`);
  }
  canvas.getContext("2d").drawImage(image, 0, 0);
  picture?.close();
  picture = image;
  count("picture");
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
  const [state, words] = overallState(summary), kind = words.replace(/\d+/g, "");
  showState(at("overall"), state, words);
  if (at("overall-said").dataset.kind !== kind) [at("overall-said").dataset.kind, at("overall-said").textContent] = [kind, words]; // not each second anew
  say("count-effect", whyFewerLights(summary));
  if (at("count-effect").textContent) at("count-effect").classList.add("was-said");
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
    const [state, words] = rowState(row, summary);
    card.dataset.state = state;
    showState(card.querySelector(".pill"), state, words);
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
  const of = byService({ services: summary.services.map((row) => ({ ...row, stated: rowState(row, summary) })) });
  cover("sky", of.fuse ?? of.capture, Boolean(sky.image), summary.control.paused);
  cover("scene", of.renderer, Boolean(picture), false);
}

function cover(id, row, hasFrame, paused) {
  const [state, words] = row.stated, line = at(`${id}-cover`), still = !["live", "finished", "behind"].includes(state);
  line.hidden = hasFrame && !still && !paused;
  line.classList.toggle("empty", !hasFrame);
  line.dataset.state = hasFrame ? (still ? state : "paused") : "";
  at(id).classList.toggle("dim", hasFrame && still);
  if (!hasFrame) {
    line.textContent = row.state === "not seen" ? `waiting for ${row.service} … (${row.text}: ${Math.round(performance.now() / 1000)} s so far)` : `${row.service}: ${row.text} …`;
  } else {
    line.textContent = still ? `${row.service}: ${words}` : "paused at this frame";
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

function lux(value) {
  return value === undefined ? "–" : `${grouped(Math.round(value))} lx`;
}

function whole(value) {
  return value === undefined || value === null ? "–" : grouped(Number(value.toFixed(3)));
}

connect();
