// What the renderer gave up for time, and why a control has no effect, in words; from the viewer's summary.

// What is missing in the newest picture; empty: nothing, or it is not known.
export function givenUp(summary) {
  const report = rowOf(summary, "renderer")?.report;
  if (!report || report.max_passes) return ""; // a pause takes its time
  const missing = [];
  const lights = summary.light_count - report.drawn_lights;
  if (lights > 0 && report.drawn_lights > 0) missing.push(`${lights} of ${summary.light_count} lights`);
  if (report.left_out_near_lights) missing.push(`${report.left_out_near_lights} of ${report.near_lights} near lights`);
  if (report.bounces_left_out) missing.push("light from surface to surface");
  if (report.map_halvings) missing.push(`sharp shadows (maps halved ${report.map_halvings === 1 ? "once" : `${report.map_halvings} times`})`);
  return missing.length ? `Left out for time: ${missing.join(", ")}.` : "";
}

const HELP = "Smaller pictures ([renderer] width, height), a longer frame_ms or a GPU would help.";

// Beside the number of lights: what is done in place of what was asked, and what would help; empty: it is done.
export function whyFewerLights(summary) {
  const made = summary.light_count, drawn = rowOf(summary, "renderer")?.report ?? {}, required = rowOf(summary, "sampler")?.report?.required_lights;
  if (!made || drawn.max_passes || summary.why_no_controls) return "";
  const { count } = summary.control, asked = count ?? (required || summary.settings.count), least = Math.min(made, drawn.drawn_lights || made);
  if (least >= asked) return "";
  const no_time = drawn.drawn_lights < made || (drawn.light_budget && made <= drawn.light_budget && drawn.light_budget < asked);
  if (no_time && count === null && required) return `${asked} would keep the error within its limit, ${least} are drawn: there is no time for more. ${HELP}`;
  if (no_time) return `${asked} asked, ${least} drawn: there is no time for more. ${HELP}`;
  if (required && required <= asked) {
    return `${made} of at most ${asked}: so few keep the error within the limit. With [sampler] error_percent = 0 it is always as many as asked.`;
  }
  return `${asked} asked, ${least} drawn.`;
}

// Below the filter's name: what it does, or why it does nothing.
export function filterWords({ settings, source }) {
  if (!settings.filtered) return "no effect: [sampler] filter is \"none\"; \"auto\" would filter";
  return source?.frames === 1 ? "no effect on one picture" : "steadier, slightly delayed";
}

function rowOf(summary, kind) {
  return summary.services.find((row) => row.kind === kind);
}
