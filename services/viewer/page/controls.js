// The controls: what the person chooses goes to POST /control, and what is in force is shown, unless a control is being used.

const HOLD_MS = 1200; // after an input the server's summary may still be older than the input; any value in 600..3000 does

export class Controls {
  constructor(notice) {
    this.notice = notice;
    this.inputAt = -Infinity;
    this.pending = null;
    this.sending = false;
    this.paused = this.typing = false; // typing: a number of lights, which is not chosen yet
    this.settings = {}; // what counts where nothing is chosen
    this.onChoose = null; // is given each choice before it is made
    for (const id of ["count", "count-number", "exposure", "exposure-text", "filtered", "pause", "reset", "no-controls"]) {
      this[id] = document.getElementById(id);
    }
    this.fieldsets = document.querySelectorAll("#controls fieldset");
    document.getElementById("controls").addEventListener("submit", (event) => event.preventDefault());
    this.count.addEventListener("input", () => this.choose({ count: countFrom(this.count.value) }));
    this["count-number"].addEventListener("input", () => { this.typing = true; });
    this["count-number"].addEventListener("blur", () => { this.typing = false; });
    this["count-number"].addEventListener("change", () => {
      this.typing = false;
      const value = Math.round(Number(this["count-number"].value));
      this.choose({ count: Math.min(1000, Math.max(1, value || 1)) });
    });
    this.exposure.addEventListener("input", () => this.choose({ exposure: Number(this.exposure.value) }));
    this.exposure.addEventListener("dblclick", () => this.choose({ exposure: 0 }));
    this.filtered.addEventListener("change", () => this.choose({ filtered: this.filtered.checked }));
    this.pause.addEventListener("click", () => this.choose({ paused: !this.paused }));
    this.reset.addEventListener("click", () => this.choose({ count: null, exposure: null, filtered: null }));
  }

  take(summary) {
    for (const fieldset of this.fieldsets) fieldset.disabled = Boolean(summary.why_no_controls);
    this["no-controls"].hidden = !summary.why_no_controls;
    this["no-controls"].textContent = summary.why_no_controls ?? "";
    this.settings = summary.settings;
    if (performance.now() - this.inputAt < HOLD_MS || this.pending) return;
    const inForce = { ...summary.settings, paused: summary.control.paused };
    for (const key of ["count", "exposure", "filtered"]) if (summary.control[key] !== null) inForce[key] = summary.control[key];
    this.show(inForce);
    this.reset.disabled = ["count", "exposure", "filtered"].every((key) => summary.control[key] === null);
  }

  show(inForce) {
    if ("count" in inForce) {
      if (countFrom(this.count.value) !== inForce.count) this.count.value = Math.round(100 * Math.log10(inForce.count));
      if (!this.typing) this["count-number"].value = inForce.count;
      this.count.setAttribute("aria-valuetext", `${inForce.count} lights`);
    }
    if ("exposure" in inForce) {
      this.exposure.value = inForce.exposure;
      const text = `${inForce.exposure < 0 ? "−" : inForce.exposure > 0 ? "+" : ""}${Math.abs(inForce.exposure).toFixed(1)} stops`;
      this["exposure-text"].textContent = text;
      this.exposure.setAttribute("aria-valuetext", text);
    }
    if ("filtered" in inForce) this.filtered.checked = inForce.filtered;
    if ("paused" in inForce) {
      this.paused = inForce.paused;
      this.pause.setAttribute("aria-pressed", String(this.paused));
      this.pause.textContent = this.paused ? "Resume" : "Pause";
    }
    for (const range of [this.count, this.exposure]) {
      range.style.setProperty("--filled", `${(100 * (range.value - range.min)) / (range.max - range.min)}%`);
    }
  }

  choose(change) {
    this.onChoose?.(change);
    this.inputAt = performance.now();
    const inForce = Object.entries(change).map(([key, value]) => [key, value ?? this.settings[key]]);
    this.show(Object.fromEntries(inForce.filter(([, value]) => value !== undefined)));
    this.pending = { ...this.pending, ...change };
    this.send();
  }

  // One request at a time; what is chosen meanwhile goes with the next.
  async send() {
    if (this.sending || !this.pending) return;
    const body = JSON.stringify(this.pending);
    this.pending = null;
    this.sending = true;
    try {
      const answer = await fetch("/control", { method: "POST", headers: { "Content-Type": "application/json" }, body });
      this.notice("control", answer.ok ? "" : await answer.text());
    } catch {
      this.notice("control", "The viewer does not answer: nothing was changed.");
    }
    this.sending = false;
    this.send();
  }
}

// The slider is logarithmic: 0..300 for 1..1000 lights.
function countFrom(value) {
  return Math.round(10 ** (Number(value) / 100));
}
