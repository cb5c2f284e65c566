// Undo and redo of what is chosen on this page: entries hold the choices before and after, and have a name. Pause, seeking, recording and armed
// fixtures are no entries: those are states of a moment, and nothing is armed or recorded by going back.

const HOLD_MS = 1200; // after a choice the server's summary may still be older than it; any value in 600..3000 does
const SAME_MS = 900; // choices of the same name, one soon after the other, are one entry: a drag, or a number being typed; 500..2000 would do
const MAX_ENTRIES = 200; // 100 to 1000 would do
const NAMES = {
  count: "number of lights", exposure: "exposure", filtered: "filter", source: "source of light", scene: "scene", speed: "speed", loop: "loop",
  in_s: "range that is played", out_s: "range that is played",
};
const STEPS = ["source", "scene", "speed", "loop", "filtered"]; // chosen at once: one after the other, they are an entry each
const KEYED = { poses: "name", lamps: "id" }; // lists whose items go back one by one, so that another page's stay as they are

export class History {
  constructor(apply) {
    this.apply = apply;
    this.control = {};
    this.done = [];
    this.undone = [];
    this.chosenAt = -Infinity;
    this.replaying = false;
    this.press = 0; // of the pointer that is down now, counted; 0: none
    this.presses = 0;
    [this.undoKey, this.redoKey, this.said] = ["undo", "redo", "hands-said"].map((id) => document.getElementById(id));
    this.undoKey.addEventListener("click", () => this.undo());
    this.redoKey.addEventListener("click", () => this.redo());
    document.addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("pointerdown", () => { this.press = ++this.presses; }, { capture: true });
    for (const kind of ["pointerup", "pointercancel"]) document.addEventListener(kind, () => this.release(this.press), { capture: true });
    this.show();
  }

  // After what is chosen at the end of a press.
  release(press) {
    setTimeout(() => { if (this.press === press) this.press = 0; });
  }

  take(summary) {
    if (performance.now() - this.chosenAt >= HOLD_MS) this.control = summary.control;
    for (const key of [this.undoKey, this.redoKey]) key.closest("span").hidden = Boolean(summary.why_no_controls);
  }

  // Takes a choice before it is made.
  record(change) {
    const keys = Object.keys(change).filter((key) => key in NAMES || key in KEYED || key === "masks" || key === "camera");
    const before = Object.fromEntries(keys.map((key) => [key, this.control[key] ?? null])), now = performance.now();
    this.control = { ...this.control, ...change };
    this.chosenAt = now;
    if (this.replaying || !keys.length) return;
    const after = Object.fromEntries(keys.map((key) => [key, change[key]])), name = nameOf(before, after), last = this.done.at(-1);
    if (JSON.stringify(before) === JSON.stringify(after)) return;
    const goesOn = last && last.name === name && !this.undone.length && (now - last.at < SAME_MS || (this.press && last.press === this.press));
    if (goesOn && !STEPS.includes(keys[0])) Object.assign(last, { after, at: now });
    else this.done = [...this.done, { name, before, after, at: now, press: this.press }].slice(-MAX_ENTRIES);
    this.undone = [];
    this.show();
  }

  undo() {
    const entry = this.done.pop();
    if (!entry) return;
    this.undone.push(entry);
    this.replay(entry.after, entry.before, `Undid: ${entry.name}`);
  }

  redo() {
    const entry = this.undone.pop();
    if (!entry) return;
    this.done.push({ ...entry, at: -Infinity });
    this.replay(entry.before, entry.after, `Done again: ${entry.name}`);
  }

  replay(from, to, line) {
    const change = {};
    for (const key of Object.keys(to)) change[key] = key in KEYED ? withItems(this.control[key], from[key], to[key], KEYED[key]) : to[key];
    this.quietly(() => this.apply(change));
    this.said.textContent = line;
    this.show();
  }

  // Choices made meanwhile are no entries.
  quietly(choose) {
    this.replaying = true;
    choose();
    this.replaying = false;
  }

  key(event) {
    const typed = event.target.closest?.("textarea, input[type=text], input[type=search], dialog");
    if (typed || !(event.ctrlKey || event.metaKey) || event.altKey || !["z", "y"].includes(event.key.toLowerCase())) return;
    event.preventDefault();
    event.key.toLowerCase() === "y" || event.shiftKey ? this.redo() : this.undo();
  }

  show() {
    for (const [key, entry, word, keys] of [[this.undoKey, this.done.at(-1), "Undo", "Ctrl-Z"], [this.redoKey, this.undone.at(-1), "Redo", "Ctrl-Shift-Z"]]) {
      key.disabled = !entry;
      key.title = entry ? `${word}: ${entry.name} (${keys})` : `Nothing to ${word.toLowerCase()}`;
      key.setAttribute("aria-label", entry ? `${word}: ${entry.name}` : word);
    }
  }
}

// The list now, with each item that differs between two other lists as it is in the second. A list that is null there becomes null.
function withItems(now, from, to, key) {
  if (to === null) return null;
  const [old, wanted] = [from ?? [], to].map((list) => new Map(list.map((item) => [item[key], item])));
  const made = new Map((now ?? []).map((item) => [item[key], item]));
  for (const name of new Set([...old.keys(), ...wanted.keys()])) {
    if (JSON.stringify(old.get(name)) === JSON.stringify(wanted.get(name))) continue;
    wanted.has(name) ? made.set(name, wanted.get(name)) : made.delete(name);
  }
  return [...made.values()];
}

// What a choice did, in words.
export function nameOf(before, after) {
  const [key, ...others] = Object.keys(after);
  for (const of of ["scene", "source"]) if (of in after) return NAMES[of];
  if (others.length && NAMES[key] !== NAMES[others[0]]) return "reset to settings";
  if (key in NAMES) return NAMES[key];
  if (key === "camera") return after.camera ? "turned the camera" : "reset the camera";
  const [old, made] = [before[key] ?? [], after[key] ?? []], id = KEYED[key];
  if (key === "masks" && made.length !== old.length) return made.length > old.length ? "drew a mask" : "removed a mask";
  if (key === "masks") return made.some((mask, k) => JSON.stringify(mask.points) !== JSON.stringify(old[k].points)) ? "moved a mask" : "changed a mask";
  const item = made.find((each) => JSON.stringify(each) !== JSON.stringify(old.find((other) => other[id] === each[id])));
  if (!item) {
    const gone = old.find((each) => !made.some((other) => other[id] === each[id]));
    return key === "poses" ? `put ${gone?.name ?? "objects"} back` : `removed lamp ${gone?.id ?? ""}`.trim();
  }
  const was = old.find((each) => each[id] === item[id]);
  const differs = (name) => was && JSON.stringify(was[name]) !== JSON.stringify(item[name]);
  if (key === "lamps" && !was) return `added lamp ${item.id}`;
  if (key === "lamps") return `${differs("size_deg") ? "resized" : differs("irradiance") ? "dimmed" : "moved"} lamp ${item.id}`;
  const verb = differs("scale") ? "scaled" : differs("power") ? "dimmed" : differs("rotation") && !differs("position") ? "turned" : "moved";
  return `${verb} ${item.name}`;
}
