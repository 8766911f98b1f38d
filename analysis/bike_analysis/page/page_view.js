// A view: a ride, laps or several recordings, with one cursor and one shown stretch for all its drawings.

const PLOTLY = { staticPlot: true, responsive: false, displayModeBar: false };
const ZOOM = 1.5;
const LEAST_ROWS = 8;
const FRAME_MS = 12;
const REST_MS = 150;

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
const clockText = seconds => `${timeText(seconds)} ${seconds < 59.995 ? "s" : "min"}`;

class View {
  constructor(root, spec) {
    Object.assign(this, { root, title: spec.title, channels: spec.channels, axes: spec.axes, axis: spec.axes[0] });
    Object.assign(this, { sections: spec.sections, spec, place: 0, parts: [], opened: null });
    this.dirty = new Set();   // parts that Plotly has to draw
    this.moving = new Set();  // of them, those of which a quick drawing is wanted before
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
    this.range = this.whole();
    const withPlaces = async line => ({ ...line, ...await decodedAll({ x: line.x, y: line.y }) });
    const lines = await Promise.all(spec.map.lines.map(withPlaces));
    this.map = { ...spec.map, lines, chosen: spec.map.colours[0] || "" };
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
      else if (kind === "follow") figure.drawn = new FollowPart(this, figure, this.spec.follow);
      else figure.drawn = new PanelPart(this, figure, this.spec.panels.find(panel => panel.key === kind));
      figure.drawn.seen = true;
      this.parts.push(figure.drawn);
      seen.observe(figure);
      for (const kind of ["pointerenter", "focusin"]) figure.addEventListener(kind, () => { this.active = figure.drawn; });
      for (const button of figure.querySelectorAll("[data-save]")) {
        button.onclick = () => save(this, figure.drawn, button.dataset.save);
      }
    }
    buildBar(this);
  }

  shown() { return this.series.filter(series => !series.hidden); }

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
    if (!column || wanted > column[column.length - 1] || wanted < column[0]) return -1;
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
    for (const part of this.parts) if (part.ranged) this.move(part, part instanceof PanelPart);
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
    for (const part of this.parts) if (which(part)) this.dirty.add(part);
    this.ask();
  }
  ask() { this.asked ||= requestAnimationFrame(() => this.frame()); }
  // Has a part follow a movement: drawn quickly now, if wanted, and by Plotly when the movement has come to rest.
  move(part, quick = true) {
    if (part.shows) {
      part.late = performance.now() + part.rest;
      if (quick) this.moving.add(part);
    }
    this.dirty.add(part);
    this.ask();
  }

  // Does what is due of the seen parts, as far as the time of a frame allows; first what has the pointer or the focus.
  work(parts, start, action) {
    const order = [...parts].filter(part => part.seen).sort((a, b) => Number(b === this.active) - Number(a === this.active));
    const done = [];
    for (const part of order) {
      if (done.length && performance.now() - start > FRAME_MS) break;
      part[action]();
      parts.delete(part);
      done.push(part);
    }
    return done;
  }
  // Quick drawings first; Plotly, which takes longer than a frame, only where nothing moves.
  frame() {
    this.asked = 0;
    const start = performance.now(), sketched = this.work(this.moving, start, "sketch");
    const drawn = sketched.length ? [] : this.drawRested(start);
    for (const part of this.moved ? this.parts : [...sketched, ...drawn]) part.point();
    if (this.moved || drawn.length) tell(this);
    this.moved = false;
    if (sketched.length) performance.measure("sketch", { start, detail: sketched.length });
    if (drawn.length) performance.measure("draw", { start, detail: drawn.length });
    if ([...this.dirty].some(part => part.seen)) this.ask(); else if (this.parts.length) this.root.dataset.ready = "yes";
  }
  drawRested(start) {
    const due = new Set([...this.dirty].filter(part => !(part.late > start))), drawn = this.work(due, start, "draw");
    for (const part of drawn) { this.dirty.delete(part); this.moving.delete(part); }
    return drawn;
  }
}

// ---- panels over distance or time -----------------------------------------------------------------------------------

class PlotPart {
  constructor(view, figure) {
    this.view = view;
    this.figure = figure;
    this.plot = figure.querySelector(".plot");
    this.paper = element("div", { className: "paper" });
    this.sheet = element("canvas", { className: "sheet", width: 1, height: 1 });
    this.area = element("div", { className: "area" });
    this.plot.replaceChildren(this.paper, this.sheet, this.area);
    this.ranged = true;
    this.rest = REST_MS;
    this.shows = null;
    new ResizeObserver(() => this.refit()).observe(this.plot);
  }
  get width() { return this.plot.clientWidth; }
  get height() { return this.plot.clientHeight; }

  // A plot's size follows the window's height too, so each is watched for itself.
  refit() {
    const { width, height } = this.shows?.layout ?? this;
    if (this.width && (width !== this.width || height !== this.height)) this.view.redraw(part => part === this);
  }

  show({ data, layout }) {
    const { margin } = layout;
    this.area.style.inset = [margin.t, margin.r, margin.b, margin.l].map(pixels => `${pixels}px`).join(" ");
    this.plot.classList.remove("moving");
    Plotly.react(this.paper, data, layout, PLOTLY);
    this.fit(layout);
  }
  // Keeps the ends of the axes and the pixels between them: what stands on the drawing is placed by these.
  fit(layout) {
    const { margin, width, height } = layout;
    this.shows = { layout, x: layout.xaxis.range, y: layout.yaxis.range,
      across: width - margin.l - margin.r, down: height - margin.t - margin.b };
  }

  // Pixels from the area's upper left corner to a point, as it is drawn now.
  pixelsOf(x, y) {
    const { x: [west, east], y: [south, north], across, down } = this.shows;
    return [(x - west) / (east - west) * across, (north - y) / (north - south) * down];
  }
  // Puts a mark on a point; a missing point has none.
  mark(dot, x, y, turn = "") {
    const [right, down] = this.pixelsOf(x, y);
    dot.hidden = !(Number.isFinite(right) && Number.isFinite(down));
    if (!dot.hidden) dot.style.transform = `translate(${right}px, ${down}px)${turn}`;
  }
}

class PanelPart extends PlotPart {
  constructor(view, figure, spec) {
    super(view, figure);
    this.spec = spec;
    this.legend = figure.querySelector(".legend");
    this.cursor = this.area.appendChild(element("div", { className: "cursor" }));
    this.chosen = this.area.appendChild(element("div", { className: "chosen", hidden: true }));
    this.points = [];
    listenTo(this.area, {
      hover: at => view.setAt(this.valueAt(at[0])),
      pan: dx => { const [a, b] = view.range, d = dx * (b - a) / this.inner; view.setRange(a - d, b - d); },
      zoom: (factor, at) => view.zoom(factor, this.valueAt(at[0])),
      reset: () => view.setRange(...view.whole()),
      select: (from, to, done) => this.select(from, to, done),
    });
  }
  get inner() { return Math.max(this.area.clientWidth, 1); }
  valueAt(pixel) { const [a, b] = this.view.range; return a + (b - a) * pixel / this.inner; }

  select(from, to, done) {
    this.chosen.hidden = done || !to;
    if (!to) return;
    const [a, b] = [Math.min(from[0], to[0]), Math.max(from[0], to[0])];
    if (done) this.view.setRange(this.valueAt(a), this.valueAt(b));
    else Object.assign(this.chosen.style, { left: `${a}px`, width: `${b - a}px` });
  }

  figureOf(width, height, asFile) { return panelFigure(this.view, this.spec, width, height, asFile); }

  draw() {
    const made = this.figureOf(this.width, this.height);
    this.show(made);
    this.lines = made.lines;
    this.label();
  }

  // Draws the same on the sheet, which then covers for Plotly's drawing; answers the ticks. Asks for no sizes, since the
  // browser would have to lay out the page.
  sketch() {
    const { width, height } = this.shows.layout, made = this.figureOf(width, height);
    const ticks = sketched(this.sheet, made);
    this.plot.classList.add("moving");
    this.fit(made.layout);
    this.lines = made.lines;
    this.label();
    return ticks;
  }

  // Legend that also reads off: name and value at the cursor of each line.
  label() {
    const key = this.lines.map(found => found.name + found.colour).join("|");
    if (key === this.labelled) return;
    this.labelled = key;
    this.values = this.lines.map(() => element("b"));
    this.legend.replaceChildren(...this.lines.map((found, k) => element("span", {},
      element("i", { style: `background:var(--${found.colour})` }), `${found.name} `, this.values[k])));
    for (const point of this.points) point.remove();
    this.points = this.lines.map(found => element("div", { className: "dot", style: `background:var(--${found.colour})` }));
    this.area.append(...this.points.toReversed());
  }

  point() {
    if (!this.lines) return;
    const { at } = this.view, [x] = this.pixelsOf(at, 0), inside = x >= -0.5 && x <= this.shows.across + 0.5;
    this.cursor.hidden = !inside;
    this.cursor.style.transform = `translateX(${x}px)`;
    this.lines.forEach((found, k) => {
      const row = this.view.rowIn(found.series), value = row < 0 ? NaN : found.column[row];
      const { unit, digits } = this.view.channels[found.line.column];
      write(this.values[k], `${numberText(value, digits)}${unit ? `\u202f${unit}` : ""}`);
      this.mark(this.points[k], inside && found.line.fill !== "band" ? at : NaN, value);
    });
  }
  get said() {
    const first = this.lines?.[0];
    return first ? `${first.name} ${this.values[0].textContent}` : "";
  }
}

// ---- the map --------------------------------------------------------------------------------------------------------

class MapPart extends PlotPart {
  constructor(view, figure) {
    super(view, figure);
    this.rest = 2 * REST_MS;  // drawn after the panels
    this.marks = view.series.filter(series => series.columns.x).map(series => ({ series, dot: element("div", {
      className: series === view.main ? "here" : "ghost", style: `--own: var(--${view.several ? series.colour : "ink"})` }) }));
    this.area.append(...this.marks.map(mark => mark.dot).reverse());
    this.scale = figure.querySelector(".scale");
    const choice = figure.querySelector("select");
    if (choice) choice.onchange = () => { view.map.chosen = choice.value; view.redraw(part => part === this); };
    const [x0, x1, y0, y1] = this.bounds();
    this.plot.style.aspectRatio = Math.min(Math.max(1.1 * (x1 - x0) / Math.max(1.1 * (y1 - y0), 1e-3), 0.75), 2.4);
    listenTo(this.area, {
      hover: at => this.hover(at),
      pan: (dx, dy) => { const k = (this.box[1] - this.box[0]) / this.width; this.look(-dx * k, dy * k, 1); },
      zoom: (factor, at) => this.zoomAt(factor, at),
      reset: () => { this.wanted = null; view.redraw(part => part === this); },
    });
  }

  // West, east, south and north end of all of the path and the lines, m.
  bounds() {
    const all = [...this.view.map.lines, ...this.view.shown().filter(s => s.columns.x).map(s => s.columns)];
    const across = all.map(c => span(c.x)), up = all.map(c => span(c.y));
    const ends = spans => [Math.min(...spans.map(v => v[0])), Math.max(...spans.map(v => v[1]))];
    return [...ends(across), ...ends(up)];
  }
  wholeBox() { return fittedBox(this.bounds(), this.width, this.height, 0.06); }
  look(dx, dy, factor) {
    const [x0, x1, y0, y1] = this.box, cx = (x0 + x1) / 2 + dx, cy = (y0 + y1) / 2 + dy;
    const w = (x1 - x0) / 2 * factor, h = (y1 - y0) / 2 * factor;
    this.box = this.wanted = [cx - w, cx + w, cy - h, cy + h];
    this.view.move(this);
  }
  // Moves and stretches the drawing that is there.
  sketch() {
    const [x0, x1, y0, y1] = this.box, [west, east, , north] = this.drawnBox, { across, down } = this.shows;
    const right = (west - x0) / (x1 - x0) * across, low = (y1 - north) / (y1 - y0) * down, scale = (east - west) / (x1 - x0);
    Object.assign(this.paper.style, { transformOrigin: "0 0", willChange: "transform",
      transform: `translate(${right}px, ${low}px) scale(${scale})` });
    Object.assign(this.shows, { x: [x0, x1], y: [y0, y1] });
  }
  zoomAt(factor, at) {
    const [x, y] = this.metres(at), [x0, x1, y0, y1] = this.box;
    this.look((x - (x0 + x1) / 2) * (1 - factor), (y - (y0 + y1) / 2) * (1 - factor), factor);
  }
  metres([px, py]) {
    const [x0, x1, y0, y1] = this.box;
    return [x0 + (x1 - x0) * px / this.width, y1 - (y1 - y0) * py / this.height];
  }

  // The row of the main path nearest to the pointer, within the stretch that the traces show.
  hover(at) {
    const [px, py] = this.metres(at), { x, y } = this.view.main.columns, axis = this.view.main.columns[this.view.axis];
    const first = rowOf(axis, this.view.range[0]), end = Math.min(rowOf(axis, this.view.range[1]) + 1, x.length);
    let best = first, least = Infinity;
    for (let i = first; i < end; i++) {
      const d = (x[i] - px) ** 2 + (y[i] - py) ** 2;
      if (d < least) { least = d; best = i; }
    }
    this.view.setPlace(best, false);
  }

  figureOf(width, height, asFile) {
    const box = asFile ? fittedBox(this.box, width - 114, height - 100, 0) : this.box;
    return mapFigure(this.view, box, width, height, asFile);
  }
  draw() {
    this.box = this.wanted ? fittedBox(this.wanted, this.width, this.height, 0) : this.wholeBox();
    Object.assign(this.paper.style, { transform: "", willChange: "" });
    this.show(this.figureOf(this.width, this.height));
    this.drawnBox = this.box;
    this.drawScale();
  }
  drawScale() {
    const { chosen } = this.view.map;
    this.scale.hidden = !chosen;
    if (!chosen) return;
    const { label, unit, digits } = this.view.channels[chosen], [low, high] = this.view.colourRange();
    const steps = Array.from({ length: LEVELS }, (_, i) => `var(--e${i}) ${100 * i / LEVELS}% ${100 * (i + 1) / LEVELS}%`);
    const bar = element("i", { style: `background:linear-gradient(90deg, ${steps.join(",")})` });
    const few = Math.min(digits, high - low > 20 ? 0 : 2);
    this.scale.replaceChildren(`${label} `, numberText(low, few), bar, `${numberText(high, few)}\u202f${unit}`);
  }
  point() {
    if (!this.shows) return;
    for (const { series, dot } of this.marks) {
      const row = series.hidden ? -1 : this.view.rowIn(series, "time"), { x, y, yaw } = series.columns;
      this.mark(dot, x[row], y[row], yaw ? ` rotate(${-(yaw[row] || 0)}rad)` : "");
    }
  }
}

class CloudPart extends PlotPart {
  constructor(view, figure, spec) {
    super(view, figure);
    this.spec = spec;
    this.ranged = false;
    this.dot = this.area.appendChild(element("div", { className: "here round", style: "--own: var(--ink)" }));
  }
  figureOf(width, height, asFile) { return cloudFigure(this.view, this.spec, width, height, asFile); }
  draw() { this.show(this.figureOf(this.width, this.height)); }
  point() {
    if (!this.shows) return;
    const { row, main } = this.view;
    this.mark(this.dot, main.columns[this.spec.x]?.[row], main.columns[this.spec.y]?.[row]);
  }
}

// ---- export ---------------------------------------------------------------------------------------------------------

async function save(view, part, format) {
  const [width, height] = part instanceof PanelPart ? [1200, 420] : [1100, 800];
  const { data, layout } = part.figureOf(width, height, true);
  const url = await Plotly.toImage({ data, layout, config: PLOTLY }, { format, width, height, scale: format === "png" ? 2 : 1 });
  const body = url.slice(url.indexOf(",") + 1);
  const file = format === "svg"
    ? new Blob([decodeURIComponent(body)], { type: "image/svg+xml" }) : new Blob([bytesOf(body)], { type: "image/png" });
  const name = `${fileName(`${view.title} ${part.figure.dataset.plot}`)}.${format}`;
  const link = element("a", { href: URL.createObjectURL(file), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 30000);
}
const fileName = words => words.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(-100);
