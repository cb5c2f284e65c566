// The scene's objects and lamps: one is selected, its position, rotation, power and scale are shown as they were chosen, or else as they are in the
// picture, and what is entered is chosen.

const HOLD_MS = 1200; // after an input the server's summary may still be older than the input; any value in 600..3000 does
const NUMBERS = ["x", "y", "z", "about-x", "about-y", "about-z", "power", "scale"];

export class Objects {
  constructor(choose) {
    this.choose = choose;
    this.objects = [];
    this.poses = [];
    this.inputAt = -Infinity;
    this.form = document.getElementById("objects");
    this.select = document.getElementById("object");
    this.reset = document.getElementById("object-reset");
    this.inputs = NUMBERS.map((id) => document.getElementById(`object-${id}`));
    this.form.addEventListener("submit", (event) => event.preventDefault());
    for (const input of this.inputs) input.addEventListener("input", () => this.enter());
    this.select.addEventListener("change", () => { this.inputAt = -Infinity; this.show(); });
    this.reset.addEventListener("click", () => this.send(this.others(this.selected().name)));
  }

  take(summary) {
    this.objects = summary.objects;
    this.reset.textContent = summary.settings.poses?.length ? "Reset to settings" : "Reset to scene file";
    this.form.hidden = this.objects.length === 0 || Boolean(summary.why_no_controls);
    const names = this.objects.map((object) => object.name);
    if (names.join("\n") !== [...this.select.options].map((option) => option.value).join("\n")) {
      const before = this.select.value;
      this.select.replaceChildren(...names.map((name) => new Option(name, name)));
      this.select.value = names.includes(before) ? before : names.find((_, k) => this.objects[k].power !== null) ?? names[0]; // a lamp
    }
    if (performance.now() - this.inputAt < HOLD_MS) return;
    this.poses = summary.control.poses;
    this.show();
  }

  // Poses as they are now, whoever chose them; null: none.
  adopt(poses) {
    this.inputAt = performance.now();
    this.poses = poses ?? [];
    this.show(true);
  }

  selected() {
    return this.objects.find((object) => object.name === this.select.value);
  }

  others(name) {
    return this.poses.filter((pose) => pose.name !== name);
  }

  // anew: also what is in the field that is being typed in.
  show(anew = false) {
    const object = this.selected();
    if (!object) return;
    const pose = this.poseNow(), [power, scale] = this.inputs.slice(-2).map((input) => input.closest("label"));
    const numbers = [...pose.position, ...anglesFromRotation(pose.rotation), pose.power ?? 0, pose.scale];
    this.inputs.forEach((input, k) => { if (anew || document.activeElement !== input) input.value = Number(numbers[k].toFixed(3)); });
    power.hidden = object.power === null;
    scale.hidden = object.power !== null;
    this.reset.disabled = this.others(object.name).length === this.poses.length;
  }

  enter() {
    const object = this.selected(), [x, y, z, ax, ay, az, power, scale] = this.inputs.map((input) => input.valueAsNumber);
    if (!this.form.checkValidity() || [x, y, z, ax, ay, az, power, scale].some(Number.isNaN)) return;
    const rotation = rotationFromAngles([ax, ay, az]);
    const own = object.power === null ? { power: null, scale } : { power };
    this.send([...this.others(object.name), { name: object.name, position: [x, y, z], rotation, ...own }]);
  }

  // The selected object's pose as it is now.
  poseNow() {
    return this.posesNow().find((pose) => pose.name === this.select.value);
  }

  posesNow() {
    return this.objects.map((object) => {
      const chosen = this.poses.find((pose) => pose.name === object.name);
      return { ...object, ...chosen, power: object.power === null ? null : chosen?.power ?? object.power, scale: (chosen ?? object).scale ?? 1 };
    });
  }

  // Moves an object to a pose.
  put({ name, position, rotation, power, scale }) {
    this.send([...this.others(name), { name, position, rotation, ...(power === null ? { power, scale } : { power }) }]);
    this.show();
  }

  selectObject(name) {
    this.select.value = name;
    this.select.dispatchEvent(new Event("change"));
  }

  send(poses) {
    this.inputAt = performance.now();
    this.poses = poses;
    this.reset.disabled = this.others(this.select.value).length === poses.length;
    this.choose({ poses });
  }
}

// Quaternion x, y, z, w of a rotation about x, then y, then z (fixed axes), in degrees, as in scene files.
export function rotationFromAngles(degrees) {
  const [a, b, c] = degrees.map((angle) => Math.sin((angle * Math.PI) / 360)), [d, e, f] = degrees.map((angle) => Math.cos((angle * Math.PI) / 360));
  return [a * e * f - d * b * c, d * b * f + a * e * c, d * e * c - a * b * f, d * e * f + a * b * c];
}

// The inverse: of the two triples of angles that give the same rotation, the one with the smaller sum of absolute values.
export function anglesFromRotation([x, y, z, w]) {
  const sine = Math.min(1, Math.max(-1, 2 * (w * y - z * x)));
  if (Math.abs(sine) > 0.999999) return [(2 * Math.atan2(x, w) * 180) / Math.PI, Math.sign(sine) * 90, 0]; // gimbal lock
  const angles = [Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), Math.asin(sine), Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))];
  const one = angles.map((angle) => (angle * 180) / Math.PI);
  const other = [opposite(one[0]), Math.sign(one[1] || 1) * 180 - one[1], opposite(one[2])];
  return sumOfAbsolute(one) <= sumOfAbsolute(other) ? one : other;
}

// 180 degrees further, in -180..180.
function opposite(angle) {
  return angle > 0 ? angle - 180 : angle + 180;
}

function sumOfAbsolute(angles) {
  return angles.reduce((sum, angle) => sum + Math.abs(angle), 0);
}
