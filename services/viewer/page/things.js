// The scene's objects and lamps: one is chosen, its place, turn and power are shown as they are wished, or as the picture has them where
// nothing is, and what the hand enters is wished.

const HOLD_MS = 1200; // after a touch, while the server's word may still be older than the hand's
const NUMBERS = ["x", "y", "z", "about-x", "about-y", "about-z", "power"];

export class Things {
  constructor(wish) {
    this.wish = wish;
    this.things = [];
    this.poses = [];
    this.touched = -Infinity;
    this.form = document.getElementById("things");
    this.chosen = document.getElementById("thing");
    this.back = document.getElementById("thing-back");
    this.inputs = NUMBERS.map((id) => document.getElementById(`thing-${id}`));
    this.form.addEventListener("submit", (event) => event.preventDefault());
    for (const input of this.inputs) input.addEventListener("input", () => this.enter());
    this.chosen.addEventListener("change", () => { this.touched = -Infinity; this.show(); });
    this.back.addEventListener("click", () => this.send(this.others(this.thing().name)));
  }

  // What stands, from the report.
  take(report) {
    this.things = report.objects;
    this.form.hidden = this.things.length === 0 || Boolean(report.why_no_controls);
    const names = this.things.map((thing) => thing.name);
    if (names.join("\n") !== [...this.chosen.options].map((option) => option.value).join("\n")) {
      const before = this.chosen.value;
      this.chosen.replaceChildren(...names.map((name) => new Option(name, name)));
      this.chosen.value = names.includes(before) ? before : names.find((_, k) => this.things[k].power !== null) ?? names[0];
    }
    if (performance.now() - this.touched < HOLD_MS) return;
    this.poses = report.wish.poses;
    this.show();
  }

  thing() {
    return this.things.find((thing) => thing.name === this.chosen.value);
  }

  others(name) {
    return this.poses.filter((pose) => pose.name !== name);
  }

  show() {
    const thing = this.thing();
    if (!thing) return;
    const pose = { ...thing, ...this.poses.find((pose) => pose.name === thing.name) };
    const numbers = [...pose.position, ...anglesFrom(pose.rotation), pose.power ?? 0];
    this.inputs.forEach((input, k) => { if (document.activeElement !== input) input.value = Number(numbers[k].toFixed(3)); });
    this.inputs.at(-1).closest("label").hidden = thing.power === null;
    this.back.disabled = this.others(thing.name).length === this.poses.length;
  }

  enter() {
    const thing = this.thing(), [x, y, z, ax, ay, az, power] = this.inputs.map((input) => input.valueAsNumber);
    if (!this.form.checkValidity() || [x, y, z, ax, ay, az, power].some(Number.isNaN)) return;
    const pose = { name: thing.name, position: [x, y, z], rotation: turnFrom([ax, ay, az]), power: thing.power === null ? null : power };
    this.send([...this.others(thing.name), pose]);
  }

  send(poses) {
    this.touched = performance.now();
    this.poses = poses;
    this.back.disabled = this.others(this.chosen.value).length === poses.length;
    this.wish({ poses });
  }
}

// Quaternion x, y, z, w of a turn about x, then y, then z (fixed axes), in degrees, as scene files have it.
export function turnFrom(degrees) {
  const [a, b, c] = degrees.map((angle) => Math.sin((angle * Math.PI) / 360)), [d, e, f] = degrees.map((angle) => Math.cos((angle * Math.PI) / 360));
  return [a * e * f - d * b * c, d * b * f + a * e * c, d * e * c - a * b * f, d * e * f + a * b * c];
}

// The other way: of the two triples that are the same turn, the one with the smaller angles.
export function anglesFrom([x, y, z, w]) {
  const sine = Math.min(1, Math.max(-1, 2 * (w * y - z * x)));
  if (Math.abs(sine) > 0.999999) return [(2 * Math.atan2(x, w) * 180) / Math.PI, Math.sign(sine) * 90, 0]; // about x and about z are one
  const angles = [Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), Math.asin(sine), Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))];
  const one = angles.map((angle) => (angle * 180) / Math.PI);
  const other = [half(one[0]), Math.sign(one[1] || 1) * 180 - one[1], half(one[2])];
  return size(one) <= size(other) ? one : other;
}

// Half a turn further, between -180 and 180 degrees.
function half(angle) {
  return angle > 0 ? angle - 180 : angle + 180;
}

function size(angles) {
  return angles.reduce((sum, angle) => sum + Math.abs(angle), 0);
}
