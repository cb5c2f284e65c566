// The state of the whole, for the pill at the top: [state, words]. It is live only while pictures of newest light come.

const WORST = ["silent", "stalled", "not seen", "starting"];
const BEHIND_S = 2; // from which age of its light a picture that comes is said to be late; 1 to 5 s would do

export function overallState(summary) {
  const { services, control, mode, measuring } = summary;
  const worst = WORST.find((state) => services.some((row) => row.state === state));
  const culprit = services.find((row) => row.state === worst);
  if (culprit) return [worst === "not seen" ? "starting" : worst, culpritWords(culprit)];
  const waiting = services.find((row) => row.state === "waiting");
  if (waiting && !services.some((row) => row.state === "finished")) return ["waiting", `${waiting.service} ${waiting.text}`];
  if (measuring.state === "running") return ["paused", "measuring this machine"];
  if (control.paused) return ["paused", pauseWords(services.find((row) => row.kind === "renderer")?.report)];
  if (services.some((row) => row.state === "finished")) return ["finished", "finished"];
  if (mode === "lossless") return ["live", "lossless"];
  const age_s = services.find((row) => row.kind === "renderer")?.age_ms / 1e3;
  return ["live", age_s >= BEHIND_S ? `live, ${age_s.toFixed(0)} s behind` : "live"];
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
