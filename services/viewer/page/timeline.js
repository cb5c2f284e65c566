// The timeline of a source of files: thumbnails, where it stands, the range that is played, and the keys that move it.

const HOLD_MS = 1500; // after a wish the server's word may still be older than it; any value in 700..3000 does
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const TYPING = ["INPUT", "SELECT", "TEXTAREA"];
const at = (id) => document.getElementById(id);

export class Timeline {
  constructor(choose) {
    this.choose = choose;
    this.source = null;
    this.position = 0; // the frame shown, as this page last knew it
    this.knownAt = 0; // when: in between it goes on by itself
    this.heldUntil = this.rangeHeldUntil = -Infinity;
    this.image = null;
    this.number = null;
    this.seekNumber = 0;
    this.first = this.last = 0;
    this.drag = null;
    this.canvas = at("strip-canvas");
    this.strip = at("strip");
    for (const speed of SPEEDS) at("speed").append(new Option(`${speed} ×`, speed, speed === 1, speed === 1));
    const on = (id, act) => at(id).addEventListener("click", act);
    on("to-first", () => this.seek(this.first));
    on("step-back", () => this.step(-1));
    on("play", () => this.play());
    on("step-on", () => this.step(1));
    on("to-last", () => this.seek(this.last));
    on("loop", () => this.choose({ loop: at("loop").getAttribute("aria-pressed") === "true" ? false : null }));
    on("in-point", () => this.range({ first: this.shown() }));
    on("out-point", () => this.range({ last: this.shown() }));
    on("whole", () => this.range({ first: 0, last: this.source.frames - 1 }));
    at("speed").addEventListener("change", () => this.choose({ speed: Number(at("speed").value) === 1 ? null : Number(at("speed").value) }));
    document.addEventListener("keydown", (event) => this.key(event));
    this.strip.addEventListener("pointerdown", (event) => this.press(event));
    this.strip.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) this.strip.addEventListener(name, () => { this.drag = null; });
    new ResizeObserver(() => this.draw()).observe(this.strip);
    setInterval(() => { if (this.playing && !this.drag) this.draw(); }, 100);
  }

  take(summary) {
    const { source, control } = summary, before = this.source;
    this.source = source;
    const held = performance.now() <= this.heldUntil; // what was wished here counts until the server has heard it
    if (!held) this.paused = control.paused;
    this.seekNumber = Math.max(this.seekNumber, control.seek_number ?? 0);
    const files = Boolean(source?.frames) && source.frames > 1;
    at("timeline").hidden = !source;
    at("transport").hidden = this.strip.hidden = !files;
    const dropped = summary.uploads?.find(({ id }) => source?.choice === `upload ${id}`); // they are stored under numbers
    at("source-name").textContent = dropped?.label ?? source?.name ?? "";
    if (!files) {
      at("place").textContent = source ? (source.frames === 1 ? "one picture" : "live") : "";
      return;
    }
    for (const part of at("transport").querySelectorAll("button, select")) part.disabled = Boolean(summary.why_no_controls);
    if (performance.now() > this.rangeHeldUntil) this.takeRange(control);
    this.speed = control.speed ?? 1;
    this.looping = control.loop !== false;
    this.playing = !this.paused && !source.at_end && summary.services.some((row) => row.kind === "capture" && row.state === "live");
    const news = !before || before.position !== source.position || before.name !== source.name || this.paused;
    if (news && !this.drag && !held) [this.position, this.knownAt] = [source.position, performance.now()];
    at("loop").setAttribute("aria-pressed", String(this.looping));
    if (document.activeElement !== at("speed")) at("speed").value = String(this.speed);
    at("whole").disabled = control.in_s === null && control.out_s === null;
    const play = this.paused || source.at_end;
    at("play").querySelector("path").setAttribute("d", play ? "M4 2l10 6-10 6z" : "M4 2h3v12H4zM9 2h3v12H9z");
    at("play").setAttribute("aria-label", play ? "Play" : "Pause");
    if (source.thumbnails_number !== this.number) this.fetchThumbnails(source);
    this.draw();
  }

  takeRange({ in_s, out_s }) {
    const { frames, fps } = this.source, frame = (seconds, other) => (seconds === null ? other : Math.min(Math.round(seconds * fps), frames - 1));
    this.first = frame(in_s, 0);
    this.last = Math.max(this.first, frame(out_s, frames - 1));
  }

  // What was chosen before is chosen again.
  adopt(change) {
    if (!("in_s" in change) || "source" in change || !this.source?.frames) return;
    this.rangeHeldUntil = performance.now() + HOLD_MS;
    this.takeRange(change);
    this.draw();
  }

  async fetchThumbnails(source) {
    const number = (this.number = source.thumbnails_number), frames = source.thumbnails;
    let image = null;
    try {
      const answer = frames.length ? await fetch(`/thumbnails.jpg?number=${number}`) : null;
      if (answer?.status === 200) image = await createImageBitmap(await answer.blob()); // 204: there are others by now, as the next summary says
    } catch {
      if (number === this.number) this.number = null; // the next summary tries again
    }
    if (number !== this.number) return void image?.close();
    this.image?.close();
    [this.image, this.frames] = [image, frames];
    this.draw();
  }

  play() {
    if (!this.source) return;
    if (this.source.at_end && !this.paused) this.seek(this.first);
    else this.pause(!this.paused);
  }

  pause(paused) {
    [this.position, this.knownAt] = [this.shown(), performance.now()];
    this.heldUntil = this.knownAt + HOLD_MS;
    this.paused = paused;
    this.playing = !paused;
    this.choose({ paused });
  }

  step(by) {
    if (!this.paused) this.pause(true);
    this.seek(this.shown() + by);
  }

  seek(frame) {
    if (!this.source) return;
    this.position = Math.min(this.source.frames - 1, Math.max(0, Math.round(frame)));
    this.knownAt = performance.now();
    this.heldUntil = this.knownAt + HOLD_MS;
    this.seekNumber += 1;
    this.choose({ seek_number: this.seekNumber, seek_s: this.position / this.source.fps });
    this.draw();
  }

  range({ first = this.first, last = this.last }) {
    const { frames, fps } = this.source;
    [first, last] = [Math.max(0, Math.round(first)), Math.min(frames - 1, Math.round(last))];
    if (first > last) return;
    this.choose({ in_s: first === 0 ? null : first / fps, out_s: last === frames - 1 ? null : last / fps });
    [this.first, this.last] = [first, last];
    this.rangeHeldUntil = performance.now() + HOLD_MS;
    this.draw();
  }

  key(event) {
    const focus = document.activeElement, here = !focus || focus === document.body || at("timeline").contains(focus);
    if (!here || event.ctrlKey || event.metaKey || event.altKey || TYPING.includes(focus?.tagName) || this.strip.hidden) return;
    if (event.key === " " && focus?.tagName === "BUTTON") return; // presses that button
    const far = Math.max(1, Math.round(this.source.frames / 10));
    const act = {
      " ": () => this.play(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1), Home: () => this.seek(this.first),
      End: () => this.seek(this.last), PageUp: () => this.seek(this.shown() + far), PageDown: () => this.seek(this.shown() - far),
      "[": () => this.range({ first: this.shown() }), "]": () => this.range({ last: this.shown() }),
    }[event.key];
    if (!act || (event.key.startsWith("Page") && focus !== this.strip)) return;
    event.preventDefault();
    act();
  }

  // What is pressed: a handle of the range, when it is near, else the frame there.
  press(event) {
    if (at("play").disabled) return;
    this.strip.setPointerCapture(event.pointerId);
    this.strip.focus({ preventScroll: true });
    const y = event.clientY - this.strip.getBoundingClientRect().top, near = (frame) => Math.abs(this.x(frame) - this.pointerX(event)) < 14;
    const onHandles = y > this.strip.clientHeight - 18;
    this.drag = onHandles && near(this.first) ? "first" : onHandles && near(this.last) ? "last" : "position";
    this.move(event);
  }

  move(event) {
    if (!this.drag) return;
    const frame = Math.round((this.pointerX(event) / Math.max(1, this.strip.clientWidth)) * (this.source.frames - 1));
    if (this.drag === "position") {
      if (frame !== this.position || event.type === "pointerdown") this.seek(frame);
    } else this.range({ [this.drag]: frame });
  }

  pointerX(event) {
    return event.clientX - this.strip.getBoundingClientRect().left;
  }

  x(frame) {
    return (frame / Math.max(1, this.source.frames - 1)) * this.strip.clientWidth;
  }

  // The frame shown now: what the server said last, and what has been played since.
  shown() {
    if (!this.playing || this.drag) return this.position;
    const played = ((performance.now() - this.knownAt) / 1e3) * this.source.fps * this.speed, span = this.last - this.first + 1;
    const on = this.position + Math.min(played, this.source.fps * this.speed * 2);
    return Math.floor(on <= this.last ? on : this.looping ? this.first + ((on - this.first) % span) : this.last);
  }

  draw() {
    if (!this.source || this.strip.hidden) return;
    const unit = devicePixelRatio, width = Math.round(this.strip.clientWidth * unit), height = Math.round(this.strip.clientHeight * unit);
    if (!width) return;
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    const c = this.canvas.getContext("2d");
    c.clearRect(0, 0, width, height);
    this.drawThumbnails(c, width, height - 16 * unit);
    const x = (frame) => this.x(frame) * unit, first = x(this.first), last = x(this.last), bar = height - 12 * unit;
    c.fillStyle = "#3a444f";
    c.fillRect(0, bar, width, 6 * unit);
    c.fillStyle = "rgb(0 0 0 / 0.6)";
    c.fillRect(0, 0, first, bar - 4 * unit);
    c.fillRect(last, 0, width - last, bar - 4 * unit);
    c.fillStyle = "#f3b95f";
    c.fillRect(first, bar, last - first, 6 * unit);
    for (const [edge, side] of [[first, 1], [last, -1]]) {
      c.fillRect(Math.min(width - 3 * unit, Math.max(0, edge - 1.5 * unit)), bar - 4 * unit, 3 * unit, 14 * unit);
      c.fillRect(Math.min(width, Math.max(0, edge)), bar + 7 * unit, side * 8 * unit, 3 * unit);
    }
    const frame = this.shown(), head = Math.min(width - 1.5 * unit, Math.max(1.5 * unit, x(frame)));
    c.fillStyle = "#fff"; // the strip is dark in both themes
    c.fillRect(head - 1.5 * unit, 0, 3 * unit, height);
    c.beginPath();
    c.arc(Math.min(width - 6 * unit, Math.max(6 * unit, head)), bar + 3 * unit, 6 * unit, 0, 2 * Math.PI);
    c.fill();
    this.say(frame);
  }

  // As many as fit beside each other, each the one of those there are that is nearest in time.
  drawThumbnails(c, width, height) {
    if (!this.image || !this.frames?.length) return;
    const side = this.image.height, count = Math.max(1, Math.round(width / height)), step = width / count;
    for (let k = 0; k < count; k++) {
      const wanted = ((k + 0.5) / count) * (this.source.frames - 1);
      const n = this.frames.reduce((best, frame, i) => (Math.abs(frame - wanted) < Math.abs(this.frames[best] - wanted) ? i : best), 0);
      const size = Math.min(step, height);
      c.drawImage(this.image, n * side, 0, side, side, k * step + (step - size) / 2, (height - size) / 2, size, size);
    }
  }

  say(frame) {
    const { frames, fps } = this.source, text = `frame ${frame} of ${frames} · ${(frame / fps).toFixed(2)} of ${(frames / fps).toFixed(2)} s`;
    if (at("place").textContent === text) return;
    at("place").textContent = text;
    this.strip.setAttribute("aria-valuemax", String(frames - 1));
    this.strip.setAttribute("aria-valuenow", String(frame));
    this.strip.setAttribute("aria-valuetext", text);
  }
}
