// The masks and virtual lamps in words: a key for each, and the numbers of the selected one.

const LAMP_FIELDS = { "lamp-azimuth": "azimuth_deg", "lamp-elevation": "elevation_deg", "lamp-size": "size_deg" };

export class SkyItems {
  constructor(tools) {
    this.tools = tools;
    for (const id of ["sky-items", "sky-item", "mask-fields", "lamp-fields", "item-mode", "item-width", "lamp-level", "lamp-colour", "sky-remove", ...Object.keys(LAMP_FIELDS)]) {
      this[id] = document.getElementById(id);
    }
    this["item-mode"].addEventListener("change", () => this.enter({ mode: this["item-mode"].value }));
    this["item-width"].addEventListener("change", () => this.enter({ width_deg: this["item-width"].valueAsNumber }, this["item-width"]));
    for (const [id, name] of Object.entries(LAMP_FIELDS)) this[id].addEventListener("input", () => this.enter({ [name]: this[id].valueAsNumber }, this[id]));
    for (const id of ["lamp-level", "lamp-colour"]) {
      this[id].addEventListener("input", () => {
        const linear = linearFromHex(this["lamp-colour"].value), top = Math.max(...linear), level = this["lamp-level"].valueAsNumber;
        this.enter({ irradiance: linear.map((value) => Number(((level * value) / top).toPrecision(6))) }, this["lamp-level"]);
      });
    }
    this["sky-remove"].addEventListener("click", () => { this.tools.change(null); this.tools.sky.canvas.focus(); });
  }

  // A change of the selected item, unless the field that it is from has no valid value.
  enter(change, field = null) {
    const item = this.tools.item();
    if (item && (!field || (field.checkValidity() && !Number.isNaN(field.valueAsNumber)))) this.tools.change({ ...item, ...change });
  }

  // anew: also what is in the field that is being typed in.
  show(anew = false) {
    const { masks, lamps, selected } = this.tools, item = this.tools.item();
    const words = [
      ...masks.map((mask, k) => ["masks", k, `Mask ${k + 1}: ${mask.mode === "dark" ? "dark" : "filled"}${mask.width_deg ? ", brush" : ""}`]),
      ...lamps.map((lamp) => ["lamps", lamp.id, `Lamp ${lamp.id}`]),
    ];
    const keys = words.map(([kind, key, text], k) => {
      const button = this["sky-items"].children[k]?.firstElementChild ?? document.createElement("button"), chosen = selected?.kind === kind && selected.key === key;
      if (button.textContent !== text) button.textContent = text;
      button.type = "button";
      button.setAttribute("aria-pressed", String(chosen));
      button.onclick = () => this.tools.select(chosen ? null : { kind, key });
      return button;
    });
    while (this["sky-items"].children.length < keys.length) this["sky-items"].append(document.createElement("li"));
    while (this["sky-items"].children.length > keys.length) this["sky-items"].lastElementChild.remove();
    keys.forEach((button, k) => { if (button.parentElement !== this["sky-items"].children[k]) this["sky-items"].children[k].append(button); });
    this["sky-items"].hidden = !keys.length;
    this["sky-item"].hidden = !item;
    this.tools.sky.canvas.toggleAttribute("data-selected", Boolean(item)); // a finger drags it, and does not scroll
    if (item) this.fill(item, selected.kind, anew);
  }

  fill(item, kind, anew) {
    const put = (input, value) => { if (anew || document.activeElement !== input) input.value = value; };
    this["mask-fields"].hidden = kind !== "masks";
    this["lamp-fields"].hidden = kind !== "lamps";
    this["sky-remove"].textContent = kind === "masks" ? "Remove mask" : `Remove lamp ${item.id}`;
    if (kind === "masks") {
      this["item-mode"].value = item.mode;
      this["item-width"].closest("label").hidden = !item.width_deg;
      put(this["item-width"], item.width_deg);
      return;
    }
    for (const [id, name] of Object.entries(LAMP_FIELDS)) put(this[id], item[name]);
    const top = Math.max(...item.irradiance);
    put(this["lamp-level"], Number(top.toPrecision(6)));
    if (top > 0 && document.activeElement !== this["lamp-colour"]) this["lamp-colour"].value = hexFromLinear(item.irradiance.map((value) => value / top));
  }
}

// IEC 61966-2-1, both ways. Black stands for white: a lamp's colour is that at full, and its level says how much.
export function linearFromHex(hex) {
  const codes = [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  const linear = codes.map((code) => (code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4));
  return Math.max(...linear) > 0 ? linear : [1, 1, 1];
}

export function hexFromLinear(linear) {
  const codes = linear.map((value) => (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));
  return `#${codes.map((code) => Math.round(255 * Math.min(1, Math.max(0, code))).toString(16).padStart(2, "0")).join("")}`;
}
