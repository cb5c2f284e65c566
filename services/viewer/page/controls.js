// The controls: what the person wants goes to POST /control, and what the server says stands is shown, unless a hand is on the control.

const HOLD_MS = 1200; // after a touch, while the server's word may still be older than the hand's

export class Controls {
  constructor(notice) {
    this.notice = notice;
    this.touched = -Infinity;
    this.pending = null;
    this.sending = false;
    this.paused = false;
    for (const id of ["count", "count-number", "exposure", "exposure-text", "filtered", "pause", "reset", "unheard"]) {
      this[id] = document.getElementById(id);
    }
    this.fieldset = document.querySelector("#controls fieldset");
    document.getElementById("controls").addEventListener("submit", (event) => event.preventDefault());
    this.count.addEventListener("input", () => this.wish({ count: countFrom(this.count.value) }));
    this["count-number"].addEventListener("change", () => {
      const value = Math.round(Number(this["count-number"].value));
      this.wish({ count: Math.min(1000, Math.max(1, value || 1)) });
    });
    this.exposure.addEventListener("input", () => this.wish({ exposure: Number(this.exposure.value) }));
    this.exposure.addEventListener("dblclick", () => this.wish({ exposure: 0 }));
    this.filtered.addEventListener("change", () => this.wish({ filtered: this.filtered.checked }));
    this.pause.addEventListener("click", () => this.wish({ paused: !this.paused }));
    this.reset.addEventListener("click", () => { this.wish({ count: null, exposure: null, filtered: null }); this.touched = -Infinity; });
  }

  // What stands, from the report.
  take(report) {
    this.fieldset.disabled = Boolean(report.why_no_controls);
    this.unheard.hidden = !report.why_no_controls;
    this.unheard.textContent = report.why_no_controls ?? "";
    if (performance.now() - this.touched < HOLD_MS || this.pending) return;
    const stands = { ...report.settings, paused: report.wish.paused };
    for (const key of ["count", "exposure", "filtered"]) if (report.wish[key] !== null) stands[key] = report.wish[key];
    this.show(stands);
    this.reset.disabled = ["count", "exposure", "filtered"].every((key) => report.wish[key] === null);
  }

  show(stands) {
    if ("count" in stands) {
      if (countFrom(this.count.value) !== stands.count) this.count.value = Math.round(100 * Math.log10(stands.count));
      if (document.activeElement !== this["count-number"] || performance.now() - this.touched < 50) this["count-number"].value = stands.count;
      this.count.setAttribute("aria-valuetext", `${stands.count} lights`);
    }
    if ("exposure" in stands) {
      this.exposure.value = stands.exposure;
      const text = `${stands.exposure < 0 ? "−" : stands.exposure > 0 ? "+" : ""}${Math.abs(stands.exposure).toFixed(1)} stops`;
      this["exposure-text"].textContent = text;
      this.exposure.setAttribute("aria-valuetext", text);
    }
    if ("filtered" in stands) this.filtered.checked = stands.filtered;
    if ("paused" in stands) {
      this.paused = stands.paused;
      this.pause.setAttribute("aria-pressed", String(this.paused));
      this.pause.textContent = this.paused ? "Paused: go on" : "Pause";
    }
    for (const range of [this.count, this.exposure]) {
      range.style.setProperty("--share", `${(100 * (range.value - range.min)) / (range.max - range.min)}%`);
    }
  }

  wish(change) {
    this.touched = performance.now();
    this.show(Object.fromEntries(Object.entries(change).filter(([, value]) => value !== null)));
    this.pending = { ...this.pending, ...change };
    this.send();
  }

  // One request at a time; what changed meanwhile goes with the next.
  async send() {
    if (this.sending || !this.pending) return;
    const body = JSON.stringify(this.pending);
    this.pending = null;
    this.sending = true;
    try {
      const answer = await fetch("/control", { method: "POST", headers: { "Content-Type": "application/json" }, body });
      this.notice("control", answer.ok ? "" : await answer.text());
    } catch {
      this.notice("control", "The viewer did not hear that: it does not answer.");
    }
    this.sending = false;
    this.send();
  }
}

// The slider runs over the logarithm: 0 .. 300 for 1 .. 1000.
function countFrom(value) {
  return Math.round(10 ** (Number(value) / 100));
}
