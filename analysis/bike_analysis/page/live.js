// A running ride: states from the WebSocket into the view's columns, manual commands of the person at the page to the ride.

const KEPT_S = 30;            // shown and kept
const COMMAND_MS = 33;        // between two commands
const KEY_RATE = 3.5;         // full lean by keys takes this part of a second
const MAP_EVERY = 6;          // frames; its mark moves with each
const PANELS_EVERY = 3;       // likewise, each in its turn: half a minute of traces moves by less than a pixel in a frame
const DEAD = 0.08;            // of a gamepad's stick

class Live {
  constructor(view, spec) {
    Object.assign(this, { view, spec, bar: document.querySelector(".live-bar"), frames: [], delays: [], states: 0, drawn: 0 });
    this.keys = new Set();
    this.pads = { steering: 0, throttle: 0 };
    this.command = { steering: 0, throttle: 0 };
    this.laps = [];
    this.others = spec.others.length ? view.series.slice(1) : [];  // the other machines of a race
    this.ghost = this.others.length ? undefined : view.series[1];
    this.ghostTime = this.ghost?.columns.time;
    this.clear();
    this.listen();
    this.connect();
    if (!spec.watched) setInterval(() => this.sendCommand(), COMMAND_MS);
  }
  // The ghost begins with the ride, and again with each lap if it is one.
  startGhost(at) { if (this.ghost) this.ghost.columns.time = this.ghostTime.map(time => time + at); }
  clear() {
    this.startGhost(0);
    this.rows = Object.fromEntries(this.spec.names.map(name => [name, []]));
    this.theirs = this.others.map(() => Object.fromEntries(this.spec.others.map(name => [name, []])));
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}${location.pathname}ws`);
    this.socket.onmessage = event => this.take(JSON.parse(event.data));
    this.socket.onopen = () => this.say("connected");
    this.socket.onclose = () => {
      this.say("no connection to the ride");
      if (!this.over) setTimeout(() => this.connect(), 1000);
    };
  }
  send(message) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

  take({ state, others, sent, reset, event, lap, status, ended, course }) {
    if (course) location.reload();  // the server has the page of the new one
    if (reset) this.clear();
    if (state) this.add(state, sent, others);
    if (lap) {
      this.laps.push(lap);
      if (this.spec.ghostLaps) this.startGhost(this.rows.time[this.rows.time.length - 1] ?? 0);
    }
    if (event) this.say(event);
    if (status) this.show(status);
    if (ended) { this.over = true; this.say("the ride has ended"); }
  }
  add(state, sent, others = []) {
    const { names, scales } = this.spec, put = (rows, values) =>
      Object.keys(rows).forEach((name, k) => rows[name].push(values[k] * (scales[name] ?? 1)));
    put(this.rows, state);
    others.forEach((values, k) => put(this.theirs[k], values));
    const { time } = this.rows, old = rowOf(time, time[time.length - 1] - KEPT_S);
    if (old > 200) for (const rows of [this.rows, ...this.theirs]) for (const name in rows) rows[name].splice(0, old);
    this.sent = sent;
    this.states += 1;
    this.drawing ||= requestAnimationFrame(() => this.draw());
  }

  // The view's columns are replaced by those of the last half minute, and the cursor stands at the newest state.
  draw() {
    this.drawing = 0;
    const { view } = this, { time } = this.rows;
    if (time.length < 2) return;
    const show = (series, rows) => {
      for (const name in rows) if (series.columns[name]) series.columns[name] = Float64Array.from(rows[name]);
    };
    show(view.main, this.rows);
    this.others.forEach((series, k) => show(series, this.theirs[k]));
    const last = time[time.length - 1];
    view.range = [Math.max(last - KEPT_S, time[0]), Math.max(last, time[0] + 1)];
    view.place = time.length - 1;
    this.drawn += 1;
    view.redraw((part, k) => (this.drawn + k) % (part.late ? MAP_EVERY : part.ranged ? PANELS_EVERY : 1) === 0);
    for (const part of view.parts) if (part.late) part.point();
    view.frameNow();
    view.root.dataset.states = this.states;
    this.measure();
  }
  // Frames a second, and the time from the state's sending to its drawing, ms.
  measure() {
    const now = performance.now();
    this.frames.push(now);
    this.delays.push(performance.timeOrigin + now - this.sent);
    while (this.frames[0] < now - 2000) { this.frames.shift(); this.delays.shift(); }
    if (!(this.measured > now - 500)) {
      this.measured = now;
      const middle = [...this.delays].sort((a, b) => a - b)[this.delays.length >> 1];
      this.rate = 1000 * (this.frames.length - 1) / (now - this.frames[0] || 1);
      this.delay = middle;
      this.say();
    }
  }
  say(words) {
    if (words) this.words = words;
    const figures = this.rate ? `${this.rate.toFixed(0)} frames/s, ${this.delay.toFixed(0)} ms behind` : "";
    const lap = this.laps.length ? `last lap ${timeText(this.laps[this.laps.length - 1])}` : "";
    write(this.bar.querySelector(".live-state"), [this.words, lap, figures].filter(Boolean).join(" · "));
  }

  // ---- controls -----------------------------------------------------------------------------------------------------

  show(status) {
    this.status = status;
    this.bar.querySelector('[data-live="pause"]').textContent = status.paused ? "Go on" : "Pause";
    if (this.spec.watched) return;
    this.bar.querySelector(`input[value="${status.hands ? "hands" : "computer"}"]`).checked = true;
    const balance = this.bar.querySelector(".balance input");
    if (balance) balance.checked = status.balance;
    this.bar.querySelector("select").value = String(status.pace);
    this.view.root.dataset.hands = status.hands ? "yes" : "no";
  }
  get hands() { return !this.spec.watched && this.bar.querySelector('input[value="hands"]').checked; }

  listen() {
    const on = (kind, action) => { this.bar.querySelector(`[data-live="${kind}"]`).onclick = action; };
    on("pause", () => this.send({ type: "pause", on: !this.status?.paused }));
    on("reset", () => this.send({ type: "reset" }));
    addEventListener("keydown", event => this.key(event, true), true);
    addEventListener("keyup", event => this.key(event, false), true);
    addEventListener("blur", () => this.keys.clear());
    if (this.spec.watched) return;
    on("step", () => this.send({ type: "step" }));
    this.bar.querySelector("select").onchange = event => this.send({ type: "pace", factor: Number(event.target.value) });
    const rider = () => this.send({ type: "rider", hands: this.hands, balance: this.bar.querySelector(".balance input")?.checked ?? true });
    for (const input of this.bar.querySelectorAll("input")) input.onchange = () => { rider(); input.blur(); };
    this.rider = rider;
    for (const pad of document.querySelectorAll(".pad")) this.listenToPad(pad);
  }
  // Before the keys of the page: here arrows ride, and do not move a cursor.
  key(event, down) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("select, input, summary")) return;
    const action = { " ": "pause", ".": "step", r: "reset" }[event.key];
    if (event.key.startsWith("Arrow")) {
      if (this.spec.watched) return;
      this.keys[down ? "add" : "delete"](event.key);
      if (down) this.takeOver();
    } else if (action) { if (down && !event.repeat) this.bar.querySelector(`[data-live="${action}"]`)?.click(); }
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
  // Whoever steers rides.
  takeOver() {
    if (this.hands) return;
    this.bar.querySelector('input[value="hands"]').checked = true;
    this.rider();
  }
  listenToPad(pad) {
    const name = pad.dataset.pad;
    const move = event => {
      const box = pad.getBoundingClientRect();
      const share = name === "steering" ? (event.clientX - box.left) / box.width : (event.clientY - box.top) / box.height;
      this.pads[name] = Math.max(-1, Math.min(1, 1 - 2 * share));
      pad.style.setProperty("--at", `${50 - 50 * this.pads[name]}%`);
    };
    const leave = () => { this.pads[name] = 0; pad.style.setProperty("--at", "50%"); };
    pad.addEventListener("pointerdown", event => { pad.setPointerCapture(event.pointerId); this.takeOver(); move(event); });
    pad.addEventListener("pointermove", event => { if (pad.hasPointerCapture(event.pointerId)) move(event); });
    for (const kind of ["pointerup", "pointercancel"]) pad.addEventListener(kind, leave);
  }

  // Positive to the left, as in a command. Keys move the lean at a rate, pads and sticks set it.
  sendCommand() {
    const pad = [...(navigator.getGamepads?.() ?? [])].find(Boolean), stick = pad?.axes[0] ?? 0;
    const pulled = k => pad?.buttons[k]?.value ?? 0, key = name => Number(this.keys.has(name));
    const held = key("ArrowLeft") - key("ArrowRight"), most = KEY_RATE * COMMAND_MS / 1000;
    const wanted = this.pads.steering || (Math.abs(stick) > DEAD ? -stick : 0);
    if (wanted) this.command.steering = wanted;
    else this.command.steering += Math.max(-most, Math.min(most, held - this.command.steering));
    this.command.throttle = this.pads.throttle || pulled(7) - pulled(6) || key("ArrowUp") - key("ArrowDown");
    if (Math.abs(stick) > DEAD || pulled(7) > DEAD || pulled(6) > DEAD) this.takeOver();
    if (this.hands) this.send({ type: "input", steering: this.command.steering, throttle: Math.max(-1, Math.min(1, this.command.throttle)) });
  }
}

const liveSpec = document.getElementById("live-data");
if (liveSpec) views[0].open().then(() => {
  views[0].setAxis("time");
  views[0].live = new Live(views[0], JSON.parse(liveSpec.textContent));
});
