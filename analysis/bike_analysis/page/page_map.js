// The map, and points of one column over another (g-g diagram): both painted on uPlot's canvas, with one scale for both axes.

const LEVELS = 16;
const MAP_POINTS = 4000;

// Rows of a path that lie apart by more than `gap` metres and inside the box, with breaks (-1) where it leaves the box.
function pathRows(x, y, first, end, gap, box) {
  const rows = [];
  let lastX = Infinity, lastY = Infinity, inside = false;
  for (let i = first; i < end; i++) {
    const dx = x[i] - lastX, dy = y[i] - lastY;
    if (dx * dx + dy * dy < gap * gap && i !== end - 1) continue;
    const seen = x[i] >= box[0] && x[i] <= box[1] && y[i] >= box[2] && y[i] <= box[3];
    if (seen && !inside && i > first) rows.push(-1);
    if (seen) rows.push(i);
    inside = seen; lastX = x[i]; lastY = y[i];
  }
  return rows;
}

// A path in steps of colour. A piece takes, with `worst`, the largest value inside it, so that no peak is lost.
function paintColoured(g, at, { x, y }, values, rows, [low, high], worst) {
  const levels = Array.from({ length: LEVELS }, () => []);
  for (let k = 0; k + 1 < rows.length; k++) {
    const i = rows[k], j = rows[k + 1];
    if (i < 0 || j < 0) continue;
    const value = worst && i < j ? values[Math.max(extremesIn(values, i, j + 1)[1], 0)] : values[j];
    const share = (value - low) / (high - low || 1);
    levels[Math.min(LEVELS - 1, Math.max(0, Math.floor((share === share ? share : 0) * LEVELS)))].push(i, j, -1);
  }
  levels.forEach((pieces, level) => { if (pieces.length) strokeRows(g, at, x, y, pieces, colour(`e${level}`), 3); });
}

const mapGap = (box, width) => 1.2 * (box[1] - box[0]) / Math.max(width, 100);

// Rows of a series or a line for a box of the map, kept until the map shows another: a zoom of the traces takes a part of them.
const rowsKept = new WeakMap();
function mapRows(series, box, width) {
  const { x, y } = series.columns ?? series, key = [...box, width].join(), kept = rowsKept.get(x);
  if (kept?.key === key) return kept.rows;
  const across = box[1] - box[0], up = box[3] - box[2];
  const wide = [box[0] - across, box[1] + across, box[2] - up, box[3] + up];
  const all = pathRows(x, y, 0, x.length, mapGap(box, width), wide);
  const every = Math.ceil(all.length / MAP_POINTS);
  const rows = every > 1 ? all.filter((row, k) => row < 0 || k % every === 0) : all;
  rowsKept.set(x, { key, rows });
  return rows;
}
// Those within [first, end), and the ends themselves.
function rowsWithin(rows, first, end) {
  const inner = rows.filter(row => row < 0 || (row > first && row < end - 1));
  return [first, ...inner, end - 1].filter((row, k, all) => row >= 0 || (k > 1 && k < all.length - 2));
}

function paintMap(view, box, width, g, at) {
  const { chosen } = view.map;
  clipTo(g, at);
  for (const line of view.map.lines) {
    const rows = mapRows(line, box, width);
    if (line.role === "reference") strokeRows(g, at, line.x, line.y, rows, colour("band"), 5);
    else strokeRows(g, at, line.x, line.y, rows, colour("muted"), 1);
  }
  for (const series of view.shown().toReversed()) {
    if (!series.columns.x || (chosen && series !== view.main)) continue;
    const { x, y } = series.columns, axis = series.columns[view.axis];
    const first = Math.max(0, rowOf(axis, view.range[0]) - 1), end = Math.min(x.length, rowOf(axis, view.range[1]) + 1);
    const all = mapRows(series, box, width), whole = first <= 1 && end >= x.length - 1;
    if (!whole) strokeRows(g, at, x, y, all, colour("muted"), 1);
    const rows = whole ? all : rowsWithin(all, first, end);
    if (series === view.main) paintBandsOnMap(view, g, at);
    if (chosen) paintColoured(g, at, series.columns, view.coloured(), rows, view.colourRange(), view.channels[chosen].absolute);
    else strokeRows(g, at, x, y, rows, colour(series.colour), 2, series.theory ? [4, 3] : []);
  }
  for (const mark of view.map.marks) mark.x.forEach((x, k) => paintSymbol(g, at, mark.symbol, x, mark.y[k], 9, colour(mark.colour)));
  for (const { x, y, text } of view.map.labels) writeAt(g, at, text, at.toX(x), at.toY(y) + 4 * at.ratio, 11, colour("muted"));
}

// Where an aid acts, as a wider line below the path.
function paintBandsOnMap(view, g, at) {
  const { x, y } = view.main.columns;
  for (const band of view.bands) for (const [first, last] of band.rows) {
    const rows = Array.from({ length: Math.min(last, x.length - 1) - first + 1 }, (_, k) => first + k);
    strokeRows(g, at, x, y, rows, inkOf(band.colour, 0.55), 9);
  }
}

// The smallest box with the proportions of the paper that holds the given one, so that both axes have one scale.
function fittedBox([x0, x1, y0, y1], width, height, room) {
  const scale = Math.max((x1 - x0) / width, (y1 - y0) / height, 1e-9) * (1 + 2 * room);
  const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
  return [cx - scale * width / 2, cx + scale * width / 2, cy - scale * height / 2, cy + scale * height / 2];
}

class MapPart extends PlotPart {
  constructor(view, figure) {
    super(view, figure);
    this.late = true;  // drawn after the panels
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
      reset: () => { this.asked = null; view.redraw(part => part === this); },
    });
  }

  // West, east, south and north end of all of the path, the lines and the labels, m.
  bounds() {
    const all = [...this.view.map.lines, ...this.view.shown().filter(s => s.columns.x).map(s => s.columns)];
    const across = all.map(c => span(c.x)), up = all.map(c => span(c.y));
    for (const { x, y } of this.view.map.labels) { across.push([x, x]); up.push([y, y]); }
    const ends = spans => [Math.min(...spans.map(v => v[0])), Math.max(...spans.map(v => v[1]))];
    return [...ends(across), ...ends(up)];
  }
  get wholeBox() { return fittedBox(this.bounds(), this.width, this.height, 0.06); }
  get box() { return this.asked ? fittedBox(this.asked, this.width, this.height, 0) : this.wholeBox; }
  look(dx, dy, factor) {
    const [x0, x1, y0, y1] = this.box, cx = (x0 + x1) / 2 + dx, cy = (y0 + y1) / 2 + dy;
    const w = (x1 - x0) / 2 * factor, h = (y1 - y0) / 2 * factor;
    this.asked = [cx - w, cx + w, cy - h, cy + h];
    this.view.redraw(part => part === this);
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

  wanted(width, height, asFile = false) {
    const { view } = this, margin = asFile ? { l: 24, r: 24, t: 92, b: 24 } : { l: 0, r: 0, t: 0, b: 0 };
    const box = asFile ? fittedBox(this.box, width - 48, height - 116, 0) : this.box, { chosen } = view.map;
    const series = view.shown().filter(one => one.columns.x && (!chosen || one === view.main));
    const names = [...view.map.lines.filter(line => line.role === "reference").map(line => ({ name: line.name, ink: colour("band") })),
      ...series.map(one => ({ name: one.name, ink: colour(chosen ? `e${LEVELS - 1}` : one.colour) })),
      ...view.bands.map(band => ({ name: band.name, ink: colour(band.colour) })),
      ...view.map.marks.map(mark => ({ name: mark.name, ink: colour(mark.colour) }))];
    if (chosen) names.push({ name: this.scaleText(" to "), ink: colour(`e${LEVELS - 1}`) });
    return {
      found: series, width, height, margin, x: [box[0], box[1]], y: [box[2], box[3]], title: view.title, legend: names, lines: [],
      xAxis: null, yAxis: null, over: (g, at) => paintMap(view, box, width, g, at),
    };
  }
  label() { this.drawScale(); }
  scaleText(between) {
    const { label, unit, digits } = this.view.channels[this.view.map.chosen], [low, high] = this.view.colourRange();
    const few = Math.min(digits, high - low > 20 ? 0 : 2);
    return `${label}: ${numberText(low, few)}${between}${numberText(high, few)}\u202f${unit}`;
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

// ---- g-g diagram ----------------------------------------------------------------------------------------------------

const CLOUD_POINTS = 1500;

class CloudPart extends PlotPart {
  constructor(view, figure, spec) {
    super(view, figure);
    this.spec = spec;
    this.ranged = false;
    this.dot = this.area.appendChild(element("div", { className: "here round", style: "--own: var(--ink)" }));
  }
  wanted(width, height, asFile = false) {
    const { view, spec } = this, margin = asFile ? marginsOf(true) : marginsOf(false, true);
    const box = fittedBox(spec.box, width - margin.l - margin.r, height - margin.t - margin.b, 0.05);
    const found = view.shown().filter(s => s.columns[spec.x] && s.columns[spec.y])
      .map(series => ({ series, name: series.name, colour: series.colour }));
    this.envelopeRow = this.nearestEnvelope();
    return {
      found, width, height, margin, x: [box[0], box[1]], y: [box[2], box[3]], title: spec.title, lines: [],
      legend: found.map(one => ({ name: one.name, ink: colour(one.colour) })),
      xAxis: { space: 60, label: spec.x_label }, yAxis: { space: 40, label: spec.y_label }, zero: paintZero,
      over: (g, at) => this.paint(g, at, found),
    };
  }
  paint(g, at, found) {
    const { spec } = this;
    clipTo(g, at);
    for (const { series } of found.toReversed()) {
      const x = series.columns[spec.x], y = series.columns[spec.y], every = Math.ceil(x.length / CLOUD_POINTS), r = 1.6 * at.ratio;
      g.beginPath();
      for (let k = 0; k < x.length; k += every) if (x[k] === x[k] && y[k] === y[k]) g.rect(at.toX(x[k]) - r, at.toY(y[k]) - r, 2 * r, 2 * r);
      g.fillStyle = inkOf(series.colour, series.theory ? 0.9 : 0.5);
      g.fill();
    }
    const curve = spec.limit?.curves[this.envelopeRow];
    if (curve) strokeRows(g, at, curve[0], curve[1], curve[0].map((_, k) => k), colour("ink"), 1.5, [6, 3]);
  }
  // The envelope of the speed nearest to the one at the cursor.
  nearestEnvelope() {
    const { limit: envelope } = this.spec, speed = this.view.main.columns.speed?.[this.view.row];
    if (!envelope || !(speed === speed)) return -1;
    return nearestRow(envelope.speeds, speed);
  }
  label({ found }) {
    const { limit: envelope } = this.spec;
    this.limit ??= envelope ? element("b") : null;
    labelSeries(this, found, ...(envelope ? [element("span", {}, element("i", { className: "limit" }), "limit of the machine at ", this.limit)] : []));
    if (this.limit && this.envelopeRow >= 0) write(this.limit, `${numberText(envelope.speeds[this.envelopeRow], 0)}\u202f${envelope.unit}`);
  }
  point() {
    if (!this.shows) return;
    const { row, main } = this.view;
    this.mark(this.dot, main.columns[this.spec.x]?.[row], main.columns[this.spec.y]?.[row]);
    if (this.spec.limit && this.nearestEnvelope() !== this.envelopeRow) this.view.redraw(part => part === this);
  }
}
