// The guide: three steps at the first visit, never again once it was closed, and behind the "?" button whenever it is wanted.

const KEY = "vemlight guide";
const at = (id) => document.getElementById(id);

export class Guide {
  constructor() {
    this.dialog = at("guide");
    this.steps = [...this.dialog.querySelectorAll("[data-step]")];
    this.step = 0;
    at("guide-open").addEventListener("click", () => this.open());
    at("guide-back").addEventListener("click", () => this.go(this.step - 1));
    at("guide-next").addEventListener("click", () => (this.step + 1 < this.steps.length ? this.go(this.step + 1) : this.dialog.close()));
    at("guide-close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener("close", () => this.remember());
    this.dialog.addEventListener("keydown", (event) => { if (event.key === "Escape") this.dialog.close(); });
    at("measure").addEventListener("click", () => this.measure());
    this.go(0);
    this.dialog.toggleAttribute("open", !this.wasClosed()); // it takes no focus by itself
  }

  // What plays, in the guide's own words.
  take(summary) {
    const text = summary.source?.name || "the source of the settings";
    if (at("guide-source").textContent !== text) at("guide-source").textContent = text;
    this.showMeasuring(summary.measuring);
  }

  // How looking for settings of this machine stands (`vemlight doctor --write`, which the viewer runs).
  showMeasuring({ state, text }) {
    this.runs = state === "running";
    const key = this.runs ? "Stop" : "Find settings for this machine", said = { running: `${text} …`, done: `Found: ${text}.`, failed: `Nothing was found: ${text}` }[state];
    if (at("measure").textContent !== key) at("measure").textContent = key;
    if (said && !this.refused && at("measure-said").textContent !== said) at("measure-said").textContent = said;
    at("measured").hidden = state !== "done";
  }

  async measure() {
    this.refused = false;
    let line = "the viewer does not answer";
    try {
      const answer = await fetch("/measure", { method: this.runs ? "DELETE" : "POST", headers: { "Content-Type": "application/json" } });
      line = answer.ok ? "" : (await answer.text()).trim().replace(/^measure: /, "");
    } catch { /* as the line says */ }
    this.refused = Boolean(line);
    if (line) at("measure-said").textContent = `Not now: ${line}`;
  }

  open() {
    this.go(0);
    this.dialog.close();
    this.dialog.show(); // above the page, not over it
  }

  go(step) {
    this.step = step;
    this.steps.forEach((each, k) => { each.hidden = k !== step; });
    at("guide-title").textContent = this.steps[step].dataset.step;
    at("guide-where").textContent = `${step + 1} of ${this.steps.length}`;
    at("guide-back").disabled = step === 0;
    at("guide-next").textContent = step + 1 < this.steps.length ? "Next" : "Done";
  }

  wasClosed() {
    try {
      return localStorage.getItem(KEY) === "closed";
    } catch { // browsers may be set to store nothing: then nobody is asked to close it at each visit
      return true;
    }
  }

  remember() {
    try {
      localStorage.setItem(KEY, "closed");
    } catch { /* as above */ }
  }
}
