// Where the light comes from: the sources that there are, files that are dropped on the page, and recording of a camera.

const SCENES = [".glb", ".gltf"];
const MAX_FILES = 1000; // of a folder: as the viewer's uploads.py
const ANEW_MS = 700; // until the capture has heard that nothing is to be recorded: controls are published twice a second
const AWAY = "the viewer does not answer, or has ended the connection";
const at = (id) => document.getElementById(id);

export class Source {
  constructor(choose) {
    this.choose = choose;
    this.summary = null;
    this.texts = {}; // of the lists, as they are shown
    this.depth = 0; // of elements that a drag is over
    at("source-list").addEventListener("change", (event) => this.pick(event.target.value || null));
    at("scene-list").addEventListener("change", (event) => this.pickScene(event.target.value || null));
    for (const id of ["source-list", "scene-list"]) {
      at(id).addEventListener("click", (event) => { if (event.target.dataset.remove) this.remove(event.target.dataset.remove); });
    }
    for (const id of ["pick-files", "pick-folder"]) {
      at(id).addEventListener("click", () => at(`${id}-input`).click());
      at(`${id}-input`).addEventListener("change", (event) => {
        const files = [...event.target.files].map((file) => ({ file, path: file.webkitRelativePath || file.name }));
        event.target.value = "";
        this.send(files.filter(({ path }) => path.split("/").length <= 2)); // of a folder those that lie in it, not deeper
      });
    }
    at("record").addEventListener("click", () => {
      if (this.wanted && !this.recording) this.choose({ record: false }); // it has ended by itself, and begins anew after that
      setTimeout(() => this.choose({ record: !this.recording }), this.wanted && !this.recording ? ANEW_MS : 0);
    });
    at("look-again").addEventListener("click", () => this.pick("recent"));
    for (const name of ["dragenter", "dragover", "dragleave", "drop"]) document.addEventListener(name, (event) => this.drag(event));
  }

  // Another source has a range of its own, and is not recorded because the one before it was.
  pick(source) {
    this.choose({ source, in_s: null, out_s: null, ...(this.wanted && { record: false }) });
  }

  // Another scene is seen by its own camera.
  pickScene(scene) {
    this.choose({ scene, camera: null });
  }

  take(summary) {
    this.summary = summary;
    const source = summary.source, live = summary.mode !== "lossless";
    at("source").hidden = !source || !live;
    if (!source || !live) return;
    const uploads = summary.uploads.filter(({ kind }) => kind === "light");
    const rows = [
      { value: "", label: "as the settings say" },
      ...source.choices.map(({ choice, label }) => ({ value: choice, label: kindOf(choice) + label })),
      ...uploads.map(({ id, label, facts }) => ({ value: `upload ${id}`, label: `dropped: ${label} (${facts})`, remove: id })),
    ];
    const chosen = summary.control.source ?? "";
    const stateOf = ({ value }) => (value === (source.choice ?? "") ? " · plays" : source.opening !== null && value === chosen ? " · opening …" : "");
    this.list("source", rows.map((row) => ({ ...row, state: stateOf(row) })), chosen);
    const refusal = source.refusal && (chosen !== (source.choice ?? "") || source.refusal.startsWith("the recording") || summary.control.record) ? source.refusal : "";
    if (at("source-refusal").textContent !== refusal) at("source-refusal").textContent = refusal;
    at("room").textContent = summary.used_bytes ? `${megabytes(summary.used_bytes)} of ${megabytes(summary.max_bytes)} for dropped files are in use` : "";
    this.takeRecording(source, summary.control.record);
    this.takeScenes(summary);
  }

  // A dropped scene has a line with a key that goes back to the settings' one.
  takeScenes({ uploads, control, services }) {
    const scenes = uploads.filter(({ kind }) => kind === "scene"), state = services.find(({ kind }) => kind === "renderer")?.state;
    at("scene-list").hidden = !scenes.length;
    const rows = [{ value: "", label: "the settings' scene" }, ...scenes.map(({ id, label, facts }) => ({ value: id, label: `scene: ${label} (${facts})`, remove: id }))];
    const chosen = control.scene ?? "", stateOf = ({ value }) => (value === chosen && state !== "live" ? " · the renderer opens it …" : "");
    this.list("scene", rows.map((row) => ({ ...row, state: stateOf(row) })), chosen);
  }

  // Choices of one kind, "source" or "scene", each with a key that removes it where that can be. Made anew when they change: the focus stays.
  list(kind, rows, chosen) {
    const text = JSON.stringify([rows, chosen]), list = at(`${kind}-list`);
    if (text === this.texts[kind]) return;
    this.texts[kind] = text;
    const focused = list.contains(document.activeElement) ? document.activeElement.value : undefined;
    list.replaceChildren(...rows.map((row) => {
      const label = document.createElement("label"), radio = document.createElement("input"), words = document.createElement("span");
      Object.assign(radio, { type: "radio", name: kind, value: row.value, checked: row.value === chosen });
      words.textContent = row.label + row.state;
      label.append(radio, words);
      if (!row.remove) return label;
      const line = document.createElement("div"), button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: "Remove" });
      button.dataset.remove = row.remove;
      button.setAttribute("aria-label", `Remove ${row.label}`);
      line.append(label, button);
      return line;
    }));
    if (focused !== undefined) (list.querySelector(`input[value="${CSS.escape(focused)}"]`) ?? list.querySelector("input")).focus();
  }

  takeRecording(source, wanted) {
    [this.wanted, this.recording] = [wanted, Boolean(source.recording)];
    const isOn = Boolean(source.recording), why = source.why_not_record;
    at("record").disabled = !isOn && !wanted && Boolean(why);
    at("record").setAttribute("aria-pressed", String(isOn));
    at("record-light").classList.toggle("on", isOn);
    const left = source.record_bytes_s > 0 ? `, ${duration(source.free_bytes / source.record_bytes_s)} at ${megabytes(source.record_bytes_s)} a second` : "";
    const room = source.free_bytes ? `${megabytes(source.free_bytes)} are free${left}` : "";
    const text = isOn ? `${source.recording}: ${source.recorded_frames} frames, ${megabytes(source.recorded_bytes)}; ${room}` : why || room;
    if (at("record-facts").textContent !== text) at("record-facts").textContent = text;
    at("look-again").hidden = !(source.recent_s > 0) || source.choice === "recent";
    at("look-again").textContent = `Look at the last ${source.recent_s.toFixed(0)} s again`;
    at("look-again").title = `They are in memory, ${megabytes(source.recent_bytes)}; while you look, the camera rests`;
  }

  drag(event) {
    if (![...(event.dataTransfer?.types ?? [])].includes("Files")) return;
    event.preventDefault();
    if (event.type === "dragenter") this.depth++;
    if (event.type === "dragleave") this.depth--;
    if (event.type === "drop") this.depth = 0;
    const over = event.target.closest?.("#sky, #scene");
    for (const id of ["sky", "scene"]) at(id).classList.toggle("dropping", this.depth > 0 && over?.id === id);
    document.body.classList.toggle("dropping", this.depth > 0);
    event.dataTransfer.dropEffect = "copy";
    if (event.type === "drop") this.drop(event);
  }

  async drop(event) {
    const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean), plain = [...event.dataTransfer.files];
    try {
      const files = entries.length ? (await Promise.all(entries.map(filesOf))).flat() : plain.map((file) => ({ file, path: file.name }));
      await this.send(files);
    } catch (error) {
      this.say(`This browser could not read what was dropped: ${error.message}`, true);
    }
  }

  // Announces, sends and has decoded what was dropped; then it is chosen. files: [{file, path}].
  async send(files) {
    const usable = files.filter(({ file }) => !file.name.startsWith(".")).sort((a, b) => a.path.localeCompare(b.path, "en", { numeric: true }));
    if (!usable.length) return this.say("There is no file in it.", true);
    if (usable.length > MAX_FILES) return this.say(`More than ${MAX_FILES} files are not taken at once.`, true);
    const isScene = SCENES.some((suffix) => usable[0].file.name.toLowerCase().endsWith(suffix)), kind = isScene ? "scene" : "light";
    const folder = usable[0].path.includes("/") ? usable[0].path.split("/")[0] : "", label = folder || usable[0].file.name;
    const total = usable.reduce((sum, { file }) => sum + file.size, 0);
    try {
      this.say(`${label}: announcing …`);
      const announced = { kind, label, files: usable.map(({ file }) => ({ name: file.name, size: file.size })) };
      const { id } = await (await asked("/uploads", "POST", JSON.stringify(announced))).json();
      let sent = 0;
      for (const [n, { file }] of usable.entries()) {
        await sentFile(`/uploads/${id}/${n}`, file, (part) => {
          this.say(`${label}: ${megabytes(sent + part)} of ${megabytes(total)}`, false, (sent + part) / Math.max(1, total));
        });
        sent += file.size;
      }
      this.say(`${label}: being decoded …`, false, 1);
      const { facts } = await (await asked(`/uploads/${id}`, "POST", "{}")).json();
      this.say(`${label}: ${facts}`);
      isScene ? this.pickScene(id) : this.pick(`upload ${id}`);
    } catch (error) {
      this.say(`${label}: ${error.message}`, true);
    }
  }

  async remove(id) {
    try {
      await asked(`/uploads/${id}`, "DELETE", undefined);
    } catch (error) {
      this.say(error.message, true);
    }
  }

  say(text, isRefusal = false, progress = null) {
    at("upload-state").setAttribute("aria-live", progress === null || progress === 1 ? "polite" : "off"); // the bar says how far it is
    at("upload-state").textContent = isRefusal ? "" : text;
    at("upload-refusal").textContent = isRefusal ? text : "";
    at("upload-progress").hidden = progress === null;
    at("upload-progress").value = progress ?? 0;
  }
}

// The answer to a request; what is refused is an Error with the viewer's line.
async function asked(path, method, body, type = "application/json") {
  let answer;
  try {
    answer = await fetch(path, { method, headers: { "Content-Type": type }, body });
  } catch {
    throw new Error(AWAY);
  }
  if (!answer.ok) throw refusalOf(await answer.text());
  return answer;
}

function refusalOf(text) {
  return new Error(text.trim().replace(/^upload: /, ""));
}

// Sends a file; `onSent` is told how many bytes have left, which fetch does not say.
function sentFile(path, file, onSent) {
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest();
    request.open("PUT", path);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.addEventListener("progress", ({ loaded }) => onSent(loaded));
    request.addEventListener("load", () => (request.status < 300 ? done() : failed(refusalOf(request.responseText))));
    request.addEventListener("error", () => failed(new Error(AWAY)));
    onSent(0);
    request.send(file);
  });
}

// The files of what was dropped: of a folder those that lie in it, not deeper.
async function filesOf(entry) {
  const fileOf = (each) => new Promise((done, failed) => each.file((file) => done({ file, path: each.fullPath.slice(1) }), failed));
  if (entry.isFile) return [await fileOf(entry)];
  const reader = entry.createReader(), found = [];
  for (;;) {
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!some.length || found.length > MAX_FILES) break;
    found.push(...some.filter((each) => each.isFile));
  }
  return Promise.all(found.map(fileOf));
}

function kindOf(choice) {
  return { camera: "camera ", recording: "recording: " }[choice.split(" ")[0]] ?? "";
}

function megabytes(count) {
  return count >= 1e9 ? `${(count / 1e9).toFixed(1)} GB` : `${(count / 1e6).toFixed(count < 1e7 ? 1 : 0)} MB`;
}

function duration(seconds) {
  return seconds < 120 ? `${seconds.toFixed(0)} s` : seconds < 7200 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(0)} h`;
}
