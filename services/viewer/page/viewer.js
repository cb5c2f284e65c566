// The page: one websocket, whose messages go to the sky, the picture, the figures and the controls.

import { Controls } from "/controls.js";
import { Kept } from "/kept.js";
import { Sky } from "/sky.js";
import { Things } from "/things.js";

const DISC = 1, PICTURE = 2; // first byte of a binary message; a JPEG follows
const AGAIN_MS = 1000;
const GREW_MS = 5000; // a count of losses is coloured while it grows, and for so long after
const MEASURES = { // of a card: label, how it reads, what it means
  age_ms: ["age", milliseconds, "of its newest frame: time since that light was seen"],
  step_ms: ["step", milliseconds, "its own time for one frame, median"],
  dropped: ["dropped", whole, "frames lost before this service saw them"],
  skipped: ["skipped", whole, "frames passed over because this service was slower than they came"],
  restarts: ["restarts", whole, "how often it had to be started again"],
  refused: ["refused", whole, "messages that were not what they should be"],
};
const OWN = { // what only one service has to say
  capture: {
    black_pixels: ["black", whole, "pixels of the newest frame that the sensor clipped at its lower end"],
    saturated_pixels: ["saturated", whole, "and at its upper end: their light is not known"],
    invalid_cells: ["spoilt", whole, "cells of the newest map that came as nan, inf or negative and count as 0"],
  },
  sampler: {
    delay_ms: ["filter delay", delay, "how far the filter holds the light back"],
    required_lights: ["need / can", needed, "lights that the scene needs for the error allowed / that the renderer draws in the time allowed"],
    flicker_hz: ["lamp flicker", flicker, "how fast the lamps beat with the frame rate"],
  },
};
const LOSSES = new Set(["dropped", "skipped", "restarts", "refused", "saturated_pixels", "invalid_cells"]);
const grown = new Map(); // of a loss: its last value and when that rose
const at = (id) => document.getElementById(id);
const sky = new Sky(at("disc"), at("light-facts"));
const controls = new Controls(notice);
const things = new Things((change) => controls.wish(change));
const kept = new Kept((wish) => controls.wish(wish));
const notices = new Map();
let picture = null;

function notice(about, text) {
  text ? notices.set(about, text) : notices.delete(about);
  at("notice").hidden = notices.size === 0;
  at("notice").textContent = [...notices.values()].join(" · ");
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => notice("socket", "");
  socket.onmessage = async ({ data }) => {
    try {
      const name = typeof data === "string" ? takeText(JSON.parse(data)) : await takePicture(new Uint8Array(data));
      await new Promise(requestAnimationFrame); // a hidden page asks for nothing
      if (socket.readyState === WebSocket.OPEN) socket.send(name);
    } catch (error) {
      notice("message", `This page could not show a message: ${error.message}`);
    }
  };
  socket.onclose = async () => {
    say(at("overall"), "lost", "viewer lost");
    document.body.classList.add("dim");
    notice("socket", (await unknown()) ? "The viewer asks for its new token: open the address that it printed." : "The viewer does not answer; trying again …");
    setTimeout(connect, AGAIN_MS);
  };
}

// Whether the viewer answers, and does not know this page. A socket that is refused does not say why.
function unknown() {
  return fetch("/healthz", { signal: AbortSignal.timeout(AGAIN_MS) }).then((answer) => answer.status === 401, () => false);
}

// Text is a report, or a frame's lights. Returns the feed's name.
function takeText(message) {
  if (message.schema === "vemlight.lights/1") {
    sky.take(message, performance.now());
    at("sky-facts").textContent = `${message.lights.length} lights · frame ${message.sequence}`;
    at("disc").setAttribute("aria-label", `The sky seen from below with ${message.lights.length} lights. ${at("light-facts").textContent}`);
    return "lights";
  }
  document.body.classList.remove("dim");
  kept.take(message);
  controls.take(message);
  things.take(message);
  showFigures(message);
  showCards(message);
  showCovers(message);
  return "report";
}

async function takePicture(bytes) {
  const image = await createImageBitmap(new Blob([bytes.subarray(1)], { type: "image/jpeg" }));
  if (bytes[0] === DISC) {
    sky.show(image);
    count("disc");
    return "disc";
  }
  if (bytes[0] !== PICTURE) throw new Error(`unknown kind ${bytes[0]}`);
  const canvas = at("picture");
  if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
  canvas.getContext("2d").drawImage(image, 0, 0);
  picture?.close();
  picture = image;
  count("picture");
  return "picture";
}

// How many have been shown, for whoever looks in from outside.
function count(id) {
  at(id).dataset.shown = Number(at(id).dataset.shown ?? 0) + 1;
}

function say(pill, state, words) {
  if (pill.dataset.state !== state) pill.dataset.state = state;
  if (pill.textContent !== words) pill.textContent = words;
}

function showFigures(report) {
  const of = Object.fromEntries(report.services.map((row) => [row.service, row]));
  at("rate").textContent = rate(of.renderer.rate_hz);
  at("latency").textContent = milliseconds(of.renderer.age_ms);
  at("delay").textContent = delay(of.sampler.delay_ms, of.sampler);
  at("missed").replaceChildren(...report.services.flatMap((row, k) => {
    const missed = (row.dropped ?? 0) + (row.skipped ?? 0), number = document.createElement("span");
    number.textContent = whole(missed);
    number.classList.toggle("lost", grows(`missed ${row.service}`, missed));
    return [`${k ? " · " : ""}${row.service} `, number];
  }));
  at("scene-facts").textContent = of.renderer.sequence === undefined || of.renderer.sequence === null ? "" : `frame ${of.renderer.sequence}`;
  const worst = ["silent", "stalled", "not heard", "starting"].find((state) => report.services.some((row) => row.state === state));
  const culprit = report.services.find((row) => row.state === worst);
  if (culprit) return say(at("overall"), worst, `${culprit.service} ${worst}`);
  if (report.wish.paused) return say(at("overall"), "paused", "paused");
  const finished = report.services.some((row) => row.state === "finished");
  say(at("overall"), finished ? "finished" : "live", finished ? "finished" : report.mode === "lossless" ? "lossless" : "live");
}

function showCards(report) {
  for (const service of report.services) {
    const row = service.service === "sampler" ? { ...report.lights, ...service } : service;
    const card = at(`card-${row.service}`) ?? newCard(row.service);
    card.dataset.state = row.state;
    say(card.querySelector(".pill"), row.state, row.words);
    card.querySelector("output").textContent = rate(row.rate_hz);
    for (const [key, [, text]] of Object.entries({ ...MEASURES, ...OWN[row.service] })) {
      const value = card.querySelector(`[data-key="${key}"]`);
      value.textContent = text(row[key], row);
      value.classList.toggle("lost", LOSSES.has(key) && grows(`${key} ${row.service}`, row[key] ?? 0));
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

function newCard(service) {
  const card = at("card").content.cloneNode(true).firstElementChild;
  card.id = `card-${service}`;
  card.querySelector("h3").textContent = service;
  for (const [key, [label, , meaning]] of Object.entries({ ...MEASURES, ...OWN[service] })) {
    const pair = document.createElement("div"), name = document.createElement("dt"), value = document.createElement("dd");
    name.textContent = label;
    pair.title = meaning;
    value.dataset.key = key;
    pair.append(name, value);
    card.querySelector("dl").append(pair);
  }
  at("services").append(card);
  return card;
}

// Over the pictures: what is awaited, or why the one below does not move.
function showCovers(report) {
  const of = Object.fromEntries(report.services.map((row) => [row.service, row]));
  cover("sky", of.capture, Boolean(sky.image), report.wish.paused);
  cover("scene", of.renderer, Boolean(picture), false);
}

function cover(id, row, hasFrame, paused) {
  const line = at(`${id}-cover`), still = !["live", "finished"].includes(row.state);
  line.hidden = hasFrame && !still && !paused;
  line.classList.toggle("empty", !hasFrame);
  line.dataset.state = hasFrame ? (still ? row.state : "paused") : "";
  at(id).classList.toggle("dim", hasFrame && still);
  if (!hasFrame) {
    line.textContent = row.state === "not heard" ? `waiting for ${row.service} …` : `${row.service}: ${row.words} …`;
  } else {
    line.textContent = still ? `${row.service}: ${row.words}` : "paused: this frame is held";
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

function delay(value, row) {
  return row.delay_frames ? `${milliseconds(value)} · ${Number(row.delay_frames.toFixed(1))} frames` : milliseconds(value);
}

// 0: nobody asked the sampler or the renderer to find out.
function needed(need, row) {
  return need || row.light_budget ? `${need || "–"} / ${row.light_budget || "–"}` : "–";
}

function flicker(beat) {
  return beat === undefined ? "–" : beat > 0 ? `${beat.toFixed(1)} Hz` : "none";
}

function whole(value) {
  return value === undefined ? "–" : value.toLocaleString("en").replaceAll(",", "\u202f");
}

connect();
