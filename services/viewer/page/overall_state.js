// What pills say, [state, words]: one service's, and the whole, for the pill at the top. Live is only what is not late.

const WORST = ["silent", "stalled", "not seen", "starting"];
const BEHIND_S = 2; // from which age of its light on what comes is late; 1 to 5 s would do

// A service whose frames come, but of light that is old, is behind. Where it is known why they are old, in a pause and in lossless mode, it is not. While
// the machine is measured, which takes all of it, services come late or not at all: they rest.
export function rowState(row, { control, mode, measuring }) {
  const age_s = row.age_ms / 1e3, isMeasured = measuring.state === "running";
  if (isMeasured && ["silent", "stalled"].includes(row.state)) return ["paused", "rests while this machine is measured"];
  const late = age_s >= BEHIND_S && !control.paused && mode !== "lossless" && !isMeasured;
  return row.state === "live" && late ? ["behind", `${duration(age_s)} behind`] : [row.state, row.text];
}

export function overallState(summary) {
  const { control, mode, measuring } = summary;
  const services = summary.services.map((row) => [row, rowState(row, summary)]).map(([row, [state, text]]) => ({ ...row, state, text }));
  const worst = WORST.find((state) => services.some((row) => row.state === state));
  const culprit = services.find((row) => row.state === worst);
  if (culprit) return [worst === "not seen" ? "starting" : worst, culpritWords(culprit)];
  if (measuring.state === "running") return ["paused", "measuring this machine"];
  const waiting = services.find((row) => row.state === "waiting");
  if (waiting && !services.some((row) => row.state === "finished")) return ["waiting", `${waiting.service} ${waiting.text}`];
  const renderer = services.find((row) => row.kind === "renderer"); // the last: what is late before it is late in it
  if (control.paused) return ["paused", pauseWords(renderer?.report)];
  if (services.some((row) => row.state === "finished")) return ["finished", "finished"];
  if (mode === "lossless") return ["live", "lossless"];
  return renderer ? [renderer.state, renderer.text] : ["live", "live"];
}

// As liveness.py has it.
function duration(seconds) {
  if (seconds < 100) return `${seconds.toFixed(0)} s`;
  return seconds < 6000 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(0)} h`;
}

function culpritWords({ service, kind, state, text }) {
  for (const word of ["compiling", "restarting"]) if (text.startsWith(word)) return `${service}: ${word}`;
  if (text.startsWith("opens")) return `${service} ${text}`;
  if (state === "not seen") return `starting: ${service}`;
  if (kind === "capture" && state === "starting") return "waiting for the source";
  return `${service} ${state}`;
}

function pauseWords(report) {
  if (!report?.max_passes) return "paused";
  return report.passes < report.max_passes ? `paused, refining: ${report.passes} of ${report.max_passes}` : "paused, refined";
}
