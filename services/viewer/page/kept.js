// The wish outlives the viewer: this browser keeps what stood last, and a viewer that was started since, with the same settings, is told it
// again unless somebody has wished already.

const KEY = "vemlight wish";
const KEPT_MS = 300_000; // a viewer that died is back within a minute; what comes later is another day's work

export class Kept {
  constructor(wish) {
    this.wish = wish;
    this.text = "null";
  }

  // What stands, from the report.
  take(report) {
    const kept = JSON.parse(this.read());
    const settings = JSON.stringify([report.mode, report.settings]);
    const again = kept && kept.started !== report.started_s && kept.settings === settings && Date.now() - kept.at < KEPT_MS;
    const stands = again && isPlain(report.wish) ? kept.wish : report.wish;
    this.write(JSON.stringify({ started: report.started_s, settings, at: Date.now(), wish: stands }));
    if (again && !isPlain(stands) && isPlain(report.wish)) this.wish(stands);
  }

  read() {
    try {
      return localStorage.getItem(KEY) ?? "null";
    } catch { // browsers can be told to store nothing: then this page alone remembers
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

// Whether nothing is wished: all as in the settings.
function isPlain(wish) {
  return Object.values(wish).every((value) => value === null || value === false || value.length === 0);
}
