// Choices outlive the viewer: this browser stores them, and repeats them to a viewer that was started since with the same settings, unless
// somebody has made new ones already.

const KEY = "vemlight controls";
const ENDS = /^(upload |recent$)/; // sources that end with their run, or their viewer
const LIFETIME_MS = 300_000; // a viewer that died is back within a minute; later than this it is another day's work

export class PersistedControls {
  constructor(choose) {
    this.choose = choose;
    this.text = "null";
  }

  take(summary) {
    const stored = parsed(this.read());
    const settings = JSON.stringify([summary.mode, summary.settings]);
    const restarted = stored && stored.started !== summary.started_s && stored.settings === settings && Date.now() - stored.at < LIFETIME_MS;
    // Never repeated by a page: fixtures keep theirs by themselves, and the rest were wishes of their moment, or sources that are gone with what is
    // in them.
    const { armed, blackout, seek_number, seek_s, scene, record, ...chosen } = summary.control;
    if (ENDS.test(chosen.source ?? "")) Object.assign(chosen, { source: null, in_s: null, out_s: null });
    const control = restarted && isDefault(chosen) ? stored.control : chosen;
    this.write(JSON.stringify({ started: summary.started_s, settings, at: Date.now(), control }));
    if (restarted && !isDefault(control) && isDefault(chosen)) this.choose(control);
  }

  read() {
    try {
      return localStorage.getItem(KEY) ?? "null";
    } catch { // browsers may be set to store nothing: then only this page remembers
      return this.text;
    }
  }

  write(text) {
    this.text = text;
    try {
      localStorage.setItem(KEY, text);
    } catch { /* as above */ }
  }
}

// What another version of the page, or somebody's hand, left there may be anything.
function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

// Whether nothing was chosen: all as in the settings.
function isDefault(control) {
  return Object.entries(control).every(([key, value]) => value === null || (key === "paused" && !value) || (key === "poses" && value.length === 0));
}
