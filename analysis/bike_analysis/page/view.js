// A view: a ride, laps or several recordings, with one cursor and one shown stretch for all its drawings.

const ZOOM = 1.5;
const LEAST_ROWS = 8;
const FRAME_MS = 12;

const element = (name, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
};
// Text that is written again as it stands would have the page laid out for nothing.
const write = (node, text) => { if (node.textContent !== text) node.textContent = text; };
const numberText = (value, digits) => value === value && value !== undefined ? value.toFixed(digits).replace("-", "−") : "–";
// As lap_text of the tables, to hundredths; rounded first, so that it never says 60 seconds.
const timeText = seconds => {
  const hundredths = Math.round(100 * seconds), minutes = Math.floor(hundredths / 6000);
  const rest = ((hundredths - 6000 * minutes) / 100).toFixed(2);
  return minutes ? `${minutes}:${rest.padStart(5, "0")}` : rest;
};
// What the reader chose, for the next page; a page may not be allowed to remember.
const KEPT_AS = "two-wheeler-lab-";
const remember = (name, value) => { try { localStorage.setItem(KEPT_AS + name, value); } catch { /* not allowed */ } };
const remembered = name => { try { return localStorage.getItem(KEPT_AS + name); } catch { return null; } };
const clockText = seconds => `${timeText(seconds)} ${seconds < 59.995 ? "s" : "min"}`;

class View {
  constructor(root, spec) {
    Object.assign(this, { root, title: spec.title, channels: spec.channels, axes: spec.axes, axis: spec.axes[0] });
    Object.assign(this, { sections: spec.sections, bands: spec.bands, spec, place: 0, parts: [], opened: null, raised: null });
    this.dirty = new Set();  // parts that have to be drawn again
  }

  // Decodes the data and draws; called when the view first comes near the screen.
  open() {
    this.opened ??= this.begin().catch(error => {
      this.root.querySelector(".traces").prepend(element("p", { className: "warning", textContent:
        "This browser cannot unpack the page's data (it lacks DecompressionStream); a version of 2023 or later can." }));
      throw error;
    });
    return this.opened;
  }

  async begin() {
    const { spec } = this;
    this.series = await Promise.all(spec.series.map(async s => ({ ...s, columns: await decodedAll(s.columns) })));
    this.main = this.series[0];
    this.several = this.series.length > 1;
    if (spec.reference !== null) this.compareWith(this.series[spec.reference]);
    this.range = this.whole();
    const withPlaces = async line => ({ ...line, ...await decodedAll({ x: line.x, y: line.y }) });
    const lines = await Promise.all(spec.lines.map(withPlaces));
    this.map = { lines, marks: spec.marks, labels: spec.labels, chosen: spec.colours[0] || "" };
    this.build();
    this.moved = true;
    this.redraw();
  }

  build() {
    const figures = this.root.querySelectorAll("[data-plot]");
    const seen = new IntersectionObserver(entries => {
      for (const entry of entries) entry.target.drawn.seen = entry.isIntersecting;
      this.moved = true;
      this.ask();
    }, { rootMargin: "80px" });
    for (const figure of figures) {
      const kind = figure.dataset.plot;
      if (kind === "map") figure.drawn = new MapPart(this, figure);
      else if (kind === "cloud") figure.drawn = new CloudPart(this, figure, this.spec.cloud);
      else if (this.spec.histograms.some(spec => spec.key === kind)) {
        figure.drawn = new HistogramPart(this, figure, this.spec.histograms.find(spec => spec.key === kind));
      }
      else if (kind === "follow") figure.drawn = new FollowPart(this, figure, this.spec.follow);
      else figure.drawn = new PanelPart(this, figure, this.spec.panels.find(panel => panel.key === kind));
      figure.drawn.seen = true;
      this.parts.push(figure.drawn);
      seen.observe(figure);
      for (const kind of ["pointerenter", "focusin"]) figure.addEventListener(kind, () => { this.active = figure.drawn; });
      for (const button of figure.querySelectorAll("[data-save]")) {
        button.onclick = () => save(this, figure.drawn);
      }
    }
    buildBar(this);
  }

  // Hands the cursor and the view from behind to another series, at the same time.
  lead(series) {
    const at = this.main.columns.time[this.row];
    Object.assign(series, { hidden: false });
    this.main = series;
    this.place = nearestRow(series.columns.time, at);
    this.moved = true;
    buildSeries(this);
    this.redraw();
  }

  shown() { return this.series.filter(series => !series.hidden); }

  // Differences of time and speed to a reference at the same distance. Each is a column of its own that is replaced, so that
  // nothing computed from the one before lives on.
  compareWith(reference) {
    this.reference = reference;
    const { distance, time, speed } = reference.columns;
    for (const series of this.series) {
      const own = series.columns, lost = (mine, its) => mine && its && minus(own.distance, mine, distance, its);
      own.delta = lost(own.time, time);
      own.speed_delta = lost(own.speed, speed);
    }
  }

  // From the first to the last place of any shown series that has the present axis.
  whole() {
    const ends = this.shown().map(s => s.columns[this.axis]).filter(Boolean).map(c => [c[0], c[c.length - 1]]);
    const low = Math.min(...ends.map(e => e[0])), high = Math.max(...ends.map(e => e[1]));
    return [low, high > low ? high : low + 1];
  }

  coloured() {
    const { chosen } = this.map, column = this.main.columns[chosen];
    if (!this.channels[chosen].absolute) return column;
    this.absolute ??= {};
    return this.absolute[chosen] ??= column.map(Math.abs);
  }
  colourRange() {
    const [low, high] = span(this.coloured());
    return this.channels[this.map.chosen].absolute ? [0, high] : [low, high];
  }

  // Row of a series beside the cursor: at the same value of the axis, or with `by` of another column (time: the ghost).
  rowIn(series, by = this.axis) {
    if (series === this.main) return this.row;
    const column = series.columns[by], wanted = this.main.columns[by][this.row];
    if (!column || wanted > 2 * column[column.length - 1] - column[column.length - 2] || wanted < 2 * column[0] - column[1]) return -1;
    return nearestRow(column, wanted);
  }

  get row() { return Math.round(this.place); }
  get at() { return this.main.columns[this.axis][this.row]; }

  setPlace(place, follow = true) {
    this.place = Math.min(Math.max(place, 0), this.main.columns[this.axis].length - 1);
    const [low, high] = this.range, at = this.at;
    if (follow && (at < low || at > high)) this.setRange(at - (high - low) / 2, at + (high - low) / 2);
    this.moved = true;
    this.ask();
  }
  setAt(value) { this.setPlace(nearestRow(this.main.columns[this.axis], value), false); }

  setRange(low, high) {
    const [first, last] = this.whole(), rows = this.main.columns.time.length;
    const least = (last - first) * Math.min(1, LEAST_ROWS / rows), width = Math.min(Math.max(high - low, least), last - first);
    low = Math.min(Math.max((low + high - width) / 2, first), last - width);
    this.range = [low, low + width];
    this.redraw(part => part.ranged);
  }
  zoom(factor, about = this.at) {
    const [low, high] = this.range;
    const from = about >= low && about <= high ? about : (low + high) / 2;
    this.setRange(from - (from - low) * factor, from + (high - from) * factor);
  }
  setAxis(axis) {
    const column = this.main.columns[this.axis], next = this.main.columns[axis];
    const rows = this.range.map(value => nearestRow(column, value)), all = this.whole();
    const isWhole = this.range[0] <= all[0] && this.range[1] >= all[1];
    this.axis = axis;
    this.moved = true;
    this.setRange(...(isWhole ? this.whole() : [next[rows[0]], next[rows[1]]]));
  }

  redraw(which = () => true) {
    this.parts.forEach((part, k) => { if (which(part, k)) this.dirty.add(part); });
    this.ask();
  }
  ask() { this.asked ||= requestAnimationFrame(() => this.frame()); }
  frameNow() { cancelAnimationFrame(this.asked); this.frame(); }
  // Draws what is due of the seen parts, as far as the time of a frame allows; first what has the pointer or the focus.
  frame() {
    this.asked = 0;
    const start = performance.now(), drawn = [];
    const first = part => part === this.active ? 0 : part.late ? 2 : 1;
    const order = [...this.dirty].filter(part => part.seen).sort((a, b) => first(a) - first(b));
    for (const part of order) {
      if (drawn.length && performance.now() - start > FRAME_MS) break;
      this.dirty.delete(part);
      part.draw();
      drawn.push(part);
    }
    for (const part of this.moved ? this.parts : drawn) part.point();
    if (this.moved || drawn.length) describeCursor(this);
    this.moved = false;
    if (drawn.length) performance.measure("draw", { start, detail: drawn.length });
    if ([...this.dirty].some(part => part.seen)) this.ask(); else if (this.parts.length) this.root.dataset.ready = "yes";
  }
}

// Controls beside the drawings: axis, zoom, playing, series, and the words about the cursor.

function buildBar(view) {
  const bar = view.root;
  const on = (name, action) => { bar.querySelector(`[data-do="${name}"]`).onclick = action; };
  for (const choice of bar.querySelectorAll("input[type=radio]")) choice.onchange = () => view.setAxis(choice.value);
  on("in", () => view.zoom(1 / ZOOM));
  on("out", () => view.zoom(ZOOM));
  on("whole", () => view.setRange(...view.whole()));
  on("play", () => play(view));
  buildSeries(view);
  const reference = view.root.querySelector("select.reference"), leader = view.root.querySelector("select.leader");
  if (leader) leader.onchange = () => view.lead(view.series[leader.value]);
  if (reference) reference.onchange = () => { view.compareWith(view.series[reference.value]); view.moved = true; view.redraw(); };
  for (const part of view.parts) if (part.plot) makeSlider(view, part);
}

function buildSeries(view) {
  const list = view.root.querySelector(".series");
  if (list && view.several) list.replaceChildren(...view.series.map(series => seriesButton(view, series)));
}

function seriesButton(view, series) {
  const button = element("button", { type: "button" }, swatch({ series, colour: series.colour }), series.name,
    ...(series.kind ? [element("small", {}, series.kind)] : []));
  button.setAttribute("aria-pressed", String(!series.hidden));
  button.disabled = series === view.main;
  button.onclick = () => {
    series.hidden = !series.hidden;
    button.setAttribute("aria-pressed", String(!series.hidden));
    view.redraw();
  };
  const raise = one => () => { view.raised = one; view.redraw(part => part instanceof PanelPart); };
  for (const kind of ["pointerenter", "focus"]) button.addEventListener(kind, raise(series));
  for (const kind of ["pointerleave", "blur"]) button.addEventListener(kind, raise(null));
  return button;
}

// Each drawing is a slider for assistive technology: its value is where the cursor stands.
function makeSlider(view, part) {
  const title = part.figure.querySelector("h4").textContent;
  Object.entries({ role: "slider", "aria-label": `${title}: cursor along the ride`, "aria-orientation": "horizontal" })
    .forEach(([name, value]) => part.plot.setAttribute(name, value));
  part.plot.tabIndex = 0;
  part.plot.addEventListener("keydown", event => { if (steer(view, event, true)) event.preventDefault(); });
}

// Keys; those that scroll the page only count where a drawing has the focus.
function steer(view, event, focused) {
  if (event.altKey || event.ctrlKey || event.metaKey) return false;
  const axis = view.main.columns[view.axis], [low, high] = view.range;
  const rows = Math.max(rowOf(axis, high) - rowOf(axis, low), 1), last = axis.length - 1;
  const step = Math.max(1, Math.round(rows / (event.shiftKey ? 20 : 200)));
  const keys = {
    ArrowRight: () => view.setPlace(view.row + step), ArrowLeft: () => view.setPlace(view.row - step),
    "+": () => view.zoom(1 / ZOOM), "=": () => view.zoom(1 / ZOOM), "-": () => view.zoom(ZOOM),
    "0": () => view.setRange(...view.whole()), p: () => play(view),
  };
  const more = {
    ArrowUp: keys.ArrowRight, ArrowDown: keys.ArrowLeft, Home: () => view.setPlace(0), End: () => view.setPlace(last),
    PageUp: () => view.setPlace(view.row + rows / 10), PageDown: () => view.setPlace(view.row - rows / 10), " ": keys.p,
  };
  const action = keys[event.key] || (focused && more[event.key]);
  if (!action) return false;
  action();
  return true;
}

function describeCursor(view) {
  const { distance, time } = view.main.columns, row = view.row;
  const section = view.sections.find(s => row >= s.first && row < s.last), length = time.length;
  const where = `${numberText(distance[row], 1)}\u202fm`, when = clockText(time[row]);
  const words = [where, when, section ? section.name : ""];
  view.root.querySelectorAll(".now span").forEach((span, k) => write(span, words[k]));
  for (const part of view.parts) {
    if (!part.plot || !part.seen) continue;
    part.plot.setAttribute("aria-valuemin", "0");
    part.plot.setAttribute("aria-valuemax", String(length - 1));
    part.plot.setAttribute("aria-valuenow", String(row));
    part.plot.setAttribute("aria-valuetext", [where, when, part.cursorText].filter(Boolean).join(", "));
  }
}

// Moves the cursor at the ride's own pace, until the end or another call.
function play(view) {
  const button = view.root.querySelector('[data-do="play"]'), rate = view.root.querySelector("select.rate");
  view.playing = !view.playing;
  button.textContent = view.playing ? "Pause" : "Play";
  if (!view.playing) return;
  const { time } = view.main.columns, last = time.length - 1;
  if (view.place >= last) view.place = 0;
  let before = null, now = timeAt(time, view.place);
  const tick = stamp => {
    if (!view.playing) return;
    if (before !== null) now += (stamp - before) / 1000 * parseFloat(rate.value);
    before = stamp;
    const row = Math.max(rowOf(time, now), 1);
    if (row > last) { view.setPlace(last); play(view); return; }
    view.setPlace(row - 1 + (now - time[row - 1]) / (time[row] - time[row - 1] || 1));
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}
const timeAt = (time, place) => {
  const row = Math.min(Math.floor(place), time.length - 2);
  return row < 0 ? time[0] : time[row] + (place - row) * (time[row + 1] - time[row]);
};

// Starts the page: views when they come near the screen, theme, keys and print.

const views = [];
const root = document.documentElement;
const darkAsked = matchMedia("(prefers-color-scheme: dark)");
const isDark = () => (root.dataset.theme || (darkAsked.matches ? "dark" : "light")) === "dark";

function recolour() {
  const button = document.getElementById("theme");
  colours.clear();
  button.setAttribute("aria-pressed", String(isDark()));
  button.textContent = isDark() ? "Light" : "Dark";
  for (const view of views) view.redraw();
}
function toggleTheme() {
  root.dataset.theme = isDark() ? "light" : "dark";
  remember("theme", root.dataset.theme);
  recolour();
}
if (remembered("theme")) root.dataset.theme = remembered("theme");

// The view that keys without a focus go to: the one in which something has been done, else the first on the screen.
function present() {
  const onScreen = views.filter(view => {
    const box = view.root.getBoundingClientRect();
    return view.series && box.bottom > 0 && box.top < innerHeight;
  });
  return onScreen.find(view => view === present.last) || onScreen[0];
}

document.addEventListener("keydown", event => {
  if (event.defaultPrevented || event.target.closest("input, select, textarea, button, summary, a")) return;
  if (event.key === "t" && !event.ctrlKey && !event.metaKey && !event.altKey) { toggleTheme(); return; }
  const view = present();
  if (view && steer(view, event, false)) event.preventDefault();
});
document.getElementById("theme").onclick = toggleTheme;
darkAsked.addEventListener("change", recolour);

// Printed in the light colours and as wide as paper.
function prepareForPrint(begin) {
  root.classList.toggle("printing", begin);
  colours.clear();
  for (const view of views) if (view.series) {
    for (const part of view.parts) part.draw();
    view.moved = true;
    view.frame();
  }
}
addEventListener("beforeprint", () => prepareForPrint(true));
addEventListener("afterprint", () => prepareForPrint(false));

const specs = JSON.parse(document.getElementById("page-data").textContent);
const near = new IntersectionObserver(entries => {
  for (const entry of entries) if (entry.isIntersecting) { near.unobserve(entry.target); entry.target.view.open(); }
}, { rootMargin: "600px" });
document.querySelectorAll(".view").forEach((section, k) => {
  const view = new View(section, specs[k]);
  section.view = view;
  views.push(view);
  section.addEventListener("pointerdown", () => { present.last = view; });
  section.addEventListener("focusin", () => { present.last = view; });
  near.observe(section);
});
recolour();

// Where there is not too much of it, the rest is drawn in idle time, so that all is there when the page is printed.
const rowsInAll = specs.flatMap(spec => spec.series).reduce((sum, series) => sum + series.columns.time.rows, 0);
const openFrom = k => setTimeout(() => views[k]?.open().then(() => openFrom(k + 1)), 300);
if (rowsInAll < 200000) openFrom(0);
