// Panels over distance or time, and histograms: which lines they have, and their paths for uPlot.

// Lines of a panel within the shown stretch: [{series, line, colour, name, x, y, whole}], the main series first.
function linesOf(view, panel, width) {
  const found = [], [low, high] = view.range;
  for (const series of view.shown()) {
    const axis = series.columns[view.axis];
    if (!axis) continue;
    const first = Math.max(0, rowOf(axis, low) - 1), end = Math.min(axis.length, rowOf(axis, high) + 2);
    for (const line of panel.lines) {
      const column = series.columns[line.column];
      if (!column || end - first < 2) continue;
      const many = view.several;
      found.push({
        series, line, first, end, column, colour: many ? series.colour : line.colour,
        name: many ? (panel.lines.length > 1 ? `${series.name}, ${line.name}` : series.name) : line.name,
        ...thinned(axis, column, first, end, Math.max(100, Math.round(width / (many ? 1.5 : 1)))),
      });
    }
  }
  return found;
}

function heightRange(lines, panel) {
  let [low, high] = panel.ends ?? (panel.zero ? [0, 0] : [Infinity, -Infinity]);
  for (const { y } of lines) {
    const [below, above] = ends(y);
    low = Math.min(low, below); high = Math.max(high, above);
  }
  if (!(low <= high)) [low, high] = [0, 1];
  const room = Math.max(high - low, panel.least || 1e-3);
  const middle = (low + high) / 2;
  low = Math.min(low, middle - room / 2); high = Math.max(high, middle + room / 2);
  return [low - (low < 0 || !panel.zero ? 0.07 : 0.02) * room, high + 0.09 * room];
}

const DOTS_BELOW = 120;
const linear = uPlot.paths.linear(), stepped = uPlot.paths.stepped({ align: -1 });

// A line for uPlot, with the area below it; a band has no line.
function drawnLine({ line, series, colour: ink, whole, x, y }) {
  const dash = series.theory || line.dash ? [4, 3] : undefined, stroked = line.fill !== "band";
  return {
    x, y: Array.from(y, value => value === value ? value : null), path: line.step ? stepped : linear, dash,
    ink: stroked ? colour(ink) : null, fill: line.fill ? inkOf(ink, stroked ? 0.2 : 0.75) : null,
    width: stroked ? series.theory ? 1.3 : 1.6 : 0, dots: whole && !line.fill && y.length < DOTS_BELOW,
  };
}

// ---- what stands below the lines ------------------------------------------------------------------------------------

// Stretches of the main series as shades, or dotted lines where they begin, with their labels on top; none where they
// would stand too close.
function paintSections(view, g, at) {
  const [low, high] = view.range, axis = view.main.columns[view.axis], { ratio } = at;
  const seen = view.sections.filter(s => axis[s.last] > low && axis[s.first] < high);
  if (seen.length > 90) return;
  let labelled = -Infinity;
  for (const section of seen) {
    const begin = axis[section.first], left = at.toX(Math.max(begin, low)), right = at.toX(Math.min(axis[section.last], high));
    if (section.shaded) {
      g.fillStyle = inkOf("band", 0.22);
      g.fillRect(left, at.top, right - left, at.down);
    } else if (begin > low) {
      g.beginPath();
      g.moveTo(left, at.top); g.lineTo(left, at.top + at.down);
      strokeNow(g, at, colour("band"), 1, [2, 3]);
    }
    const middle = (left + right) / 2, room = (4 + 7 * section.label.length) * ratio;
    if (right - left > (section.shaded ? 5 : 14) * ratio && middle - labelled > room) {
      labelled = middle;
      writeAt(g, at, section.label, middle, at.top - 4 * ratio, 10.5, colour("muted"));
    }
  }
}

// Where an aid acted on the main series: a strip for each along the foot of the panel.
const BAND_HEIGHT = 5;
function paintBands(view, keys, g, at) {
  const axis = view.main.columns[view.axis], [low, high] = view.range;
  keys.map(key => view.bands.find(band => band.key === key)).filter(Boolean).forEach((band, level) => {
    g.fillStyle = colour(band.colour);
    const y = at.top + at.down - (level + 1) * (BAND_HEIGHT + 1) * at.ratio;
    for (const [first, last] of band.rows) {
      const begin = axis[first], end = axis[Math.min(last, axis.length - 1)];
      if (end < low || begin > high) continue;
      const left = at.toX(Math.max(begin, low)), right = at.toX(Math.min(end, high));
      g.fillRect(left, y, Math.max(right - left, at.ratio), BAND_HEIGHT * at.ratio);
    }
  });
}
// Names of the aids that acted, with their colours.
const bandLegend = (view, which = () => true) => view.bands.filter(which).map(band =>
  element("span", {}, element("i", { className: "block", style: `background:var(--${band.colour})` }), band.name));

// What happened to a series, as a fall: an upright line with its name.
function paintMoments(view, g, at) {
  const [low, high] = view.range;
  for (const { series: k, row, label } of view.spec.moments) {
    const series = view.series[k], place = series.columns[view.axis][row];
    if (series.hidden || !(place >= low && place <= high)) continue;
    const x = at.toX(place), right = x > at.left + 0.8 * at.across;
    g.beginPath();
    g.moveTo(x, at.top); g.lineTo(x, at.top + at.down);
    strokeNow(g, at, colour("bad"), 1.5, [5, 3]);
    writeAt(g, at, label, x + (right ? -5 : 5) * at.ratio, at.top + 12 * at.ratio, 11, colour("bad"), right ? "right" : "left", "600");
  }
}
function paintZero(g, at) {
  const y = at.toY(0);
  if (y < at.top || y > at.top + at.down) return;
  g.fillStyle = colour("band");
  g.fillRect(at.left, Math.round(y), at.across, at.ratio);
}

// ---- parts of a view ------------------------------------------------------------------------------------------------

class PlotPart {
  constructor(view, figure) {
    Object.assign(this, { view, figure, plot: figure.querySelector(".plot"), legend: figure.querySelector(".legend") });
    this.paper = element("div", { className: "paper" });
    this.area = element("div", { className: "area" });
    this.plot.replaceChildren(this.paper, this.area);
    this.chart = new Chart(this.paper);
    this.ranged = true;
    this.shows = null;
    this.fileSize = [1600, 1160];
    new ResizeObserver(() => this.refit()).observe(this.plot);
  }
  get width() { return this.plot.clientWidth; }
  get height() { return this.plot.clientHeight; }

  // A plot's size follows the window's height too, so each is watched for itself.
  refit() {
    const { width, height } = this.shows ?? this;
    if (this.width && (width !== this.width || height !== this.height)) this.view.redraw(part => part === this);
  }

  draw() {
    const { width, height } = this;
    if (!width || !height) { this.folded?.(); return; }
    const wanted = this.wanted(width, height), { margin, x, y } = wanted;
    const inset = [margin.t, margin.r, margin.b, margin.l].map(pixels => `${pixels}px`).join(" ");
    if (inset !== this.inset) this.area.style.inset = this.inset = inset;
    this.shows = { width, height, x, y, across: width - margin.l - margin.r, down: height - margin.t - margin.b };
    this.chart.show(wanted);
    this.label?.(wanted);
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
    this.fileSize = [1600, 560];
    this.cursor = this.area.appendChild(element("div", { className: "cursor" }));
    this.chosen = this.area.appendChild(element("div", { className: "chosen", hidden: true }));
    this.points = [];
    const fold = figure.querySelector(".fold");
    const show = folded => fold.setAttribute("aria-expanded", String(!figure.classList.toggle("folded", folded)));
    fold.onclick = () => {
      show(!figure.classList.contains("folded"));
      remember(`fold-${spec.key}`, figure.classList.contains("folded") ? "yes" : "no");
    };
    if (remembered(`fold-${spec.key}`)) show(remembered(`fold-${spec.key}`) === "yes");
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

  // The main series is drawn last, so on top, where several lie on each other; a legend keeps their order.
  wanted(width, height, asFile = false) {
    const { view, spec } = this, margin = marginsOf(asFile), inner = width - margin.l - margin.r;
    const found = linesOf(view, spec, inner), axis = view.channels[view.axis];
    const front = view.several ? found.toReversed() : found;
    const { unit } = view.channels[spec.lines[0].column], label = unit ? `${spec.title} in ${unit}` : spec.title;
    return {
      found, width, height, margin, x: view.range, y: heightRange(found, spec), title: spec.title,
      lines: front.sort((a, b) => Number(a.series === view.raised) - Number(b.series === view.raised)).map(drawnLine),
      legend: found.map(({ name, colour: ink, series, line }) => ({ name, ink: colour(ink), dash: series.theory || line.dash ? [4, 3] : [] })),
      xAxis: { space: 80, grid: !view.sections.length, ...(asFile ? { label: `${axis.label} in ${axis.unit}` } : { suffix: `\u202f${axis.unit}` }) },
      yAxis: { space: 26, ...(asFile ? { label } : {}) },
      under: (g, at) => paintSections(view, g, at), zero: paintZero,
      over: (g, at) => { paintBands(view, spec.bands, g, at); paintMoments(view, g, at); },
    };
  }

  // Legend that also reads off: name and value at the cursor of each line.
  label({ found }) {
    this.lines = found;
    const key = found.map(one => one.name + one.colour).join("|");
    if (key === this.labelled) return;
    this.labelled = key;
    this.values = found.map(() => element("b"));
    this.legend.replaceChildren(...found.map((one, k) => element("span", {}, swatch(one), `${one.name} `, this.values[k])),
      ...bandLegend(this.view, band => this.spec.bands.includes(band.key)));
    for (const point of this.points) point.remove();
    this.points = found.map(one => element("div", { className: "dot", style: `background:var(--${one.colour})` }));
    this.area.append(...this.points.toReversed());
  }

  // Only the head is shown: names and values at the cursor.
  folded() { this.label({ found: linesOf(this.view, this.spec, 100) }); }

  point() {
    if (!this.lines) return;
    const { at } = this.view, [x] = this.shows ? this.pixelsOf(at, 0) : [NaN];
    const inside = x >= -0.5 && x <= this.shows.across + 0.5;
    this.cursor.hidden = !inside;
    if (inside) this.cursor.style.transform = `translateX(${x}px)`;
    this.lines.forEach((found, k) => {
      const row = this.view.rowIn(found.series), value = row < 0 ? NaN : found.column[row];
      const { unit, digits } = this.view.channels[found.line.column];
      write(this.values[k], `${numberText(value, digits)}${unit ? `\u202f${unit}` : ""}`);
      if (this.shows) this.mark(this.points[k], inside && found.line.fill !== "band" ? at : NaN, value);
    });
  }
  get cursorText() {
    const first = this.lines?.[0];
    return first ? `${first.name} ${this.values[0].textContent}` : "";
  }
}

// The sample of a line in a legend, dashed as the line is.
function swatch({ colour: ink, series, line }) {
  const dashed = series.theory || line?.dash;
  const style = dashed ? `background:repeating-linear-gradient(90deg, var(--${ink}) 0 4px, transparent 4px 7px)` : `background:var(--${ink})`;
  return element("i", { style });
}

// How often a quantity had which value: shares of the time, computed with the page, one outline a series.
class HistogramPart extends PlotPart {
  constructor(view, figure, spec) {
    super(view, figure);
    this.spec = spec;
    this.ranged = false;
    this.fileSize = [1600, 820];
  }
  wanted(width, height, asFile = false) {
    const { view, spec } = this, { edges } = spec;
    const found = view.shown().filter(series => spec.shares[series.name]).map(series => ({ series, name: series.name, colour: series.colour,
      line: { fill: series === view.main ? "area" : "", step: true }, first: 0, end: 2, whole: false,
      x: [edges[0], ...edges, edges[edges.length - 1]], y: [0, spec.shares[series.name][0], ...spec.shares[series.name], 0] }));
    const top = Math.max(1, ...found.flatMap(one => one.y));
    return {
      found, width, height, margin: marginsOf(asFile, true), x: [edges[0], edges[edges.length - 1]], y: [0, 1.08 * top], title: spec.title,
      lines: found.toReversed().map(drawnLine), legend: found.map(one => ({ name: one.name, ink: colour(one.colour) })),
      xAxis: { space: 60, label: spec.label, grid: false }, yAxis: { space: 34, suffix: "\u202f%" },
    };
  }
  label({ found }) { labelSeries(this, found); }
  point() {}
}

function labelSeries(part, found, ...more) {
  const key = found.map(one => one.name + one.colour).join("|");
  if (key === part.labelled) return;
  part.labelled = key;
  part.legend.replaceChildren(...found.map(one => element("span", {}, swatch(one), one.name)), ...more);
}

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
    const value = worst && i < j ? values[Math.max(extremeRows(values, i, j + 1)[1], 0)] : values[j];
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
      style: `--own: var(--${view.several ? series.colour : "ink"})` }) }));
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
  label() {
    this.drawScale();
    if (!this.legend.childElementCount) this.legend.replaceChildren(...bandLegend(this.view));
  }
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
      dot.className = series === this.view.main ? "here" : "ghost";
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
