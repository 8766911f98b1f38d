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
  for (const { column, first, end } of lines) {
    const [below, above] = span(column, first, end);
    low = Math.min(low, below); high = Math.max(high, above);
  }
  if (!(low <= high)) [low, high] = [0, 1];
  const room = Math.max(high - low, panel.least || 1e-3);
  const middle = (low + high) / 2;
  low = Math.min(low, middle - room / 2); high = Math.max(high, middle + room / 2);
  return [low - (low < 0 || !panel.zero ? 0.07 : 0.02) * room, high + 0.09 * room];
}

// ---- paths ----------------------------------------------------------------------------------------------------------

// Many rows become one upright bar for each column of pixels, from the lowest to the highest place that the line reaches
// in it: no peak is lost, and bars are filled faster than long lines are stroked. Few rows are a line as it is.
const FEW_POINTS = 160;
const DOTS_BELOW = 120;

// Lines for uPlot, the area below a line before it: [{ ink, width, dash, path }].
function drawnLines(found) {
  const { line, series } = found, dash = series.theory || line.dash ? [4, 3] : undefined, drawn = [];
  if (line.fill) drawn.push({ ink: inkOf(found.colour, line.fill === "band" ? 0.75 : 0.2), width: 0, path: at => ({ fill: areaPath(found, at) }) });
  if (line.fill !== "band") drawn.push({ ink: colour(found.colour), width: series.theory ? 1.3 : 1.6, dash, path: at => linePath(found, at, dash) });
  return drawn.map(one => ({ ...one, path: at => ({ stroke: null, fill: null, clip: null, band: null, gaps: null, flags: 0, ...one.path(at) }) }));
}

function linePath(found, at, dash) {
  const path = new Path2D(), { x, y, line } = found;
  if (x.length > FEW_POINTS) {
    const { low, high } = columnsOf(found, at), thick = (found.series.theory ? 1.3 : 1.6) * at.ratio, half = thick / 2;
    for (let c = 0; c < low.length; c++) {
      if (low[c] > high[c] || (dash && c % (7 * at.ratio) >= 4 * at.ratio)) continue;
      path.rect(at.left + c + 0.5 - half, low[c] - half, thick, high[c] - low[c] + thick);
    }
    return { fill: path };
  }
  let before = NaN;
  for (let k = 0; k < x.length; k++) {
    if (y[k] !== y[k]) { before = NaN; continue; }
    const px = at.toX(x[k]), py = at.toY(y[k]);
    if (before !== before) path.moveTo(px, py);
    else { if (line.step) path.lineTo(before, py); path.lineTo(px, py); }
    before = px;
  }
  if (!found.whole || line.fill || found.end - found.first >= DOTS_BELOW) return { stroke: path };
  const dots = new Path2D();
  for (let k = 0; k < x.length; k++) if (y[k] === y[k]) { dots.moveTo(at.toX(x[k]) + 2 * at.ratio, at.toY(y[k])); dots.arc(at.toX(x[k]), at.toY(y[k]), 2 * at.ratio, 0, DISC); }
  return { stroke: path, fill: dots };
}

function areaPath(found, at) {
  const path = new Path2D(), zero = at.toY(0), { x, y, line } = found;
  if (x.length > FEW_POINTS) {
    const { low, high } = columnsOf(found, at);
    for (let c = 0; c < low.length; c++) {
      const top = Math.min(low[c], zero);
      if (low[c] <= high[c]) path.rect(at.left + c, top, 1, Math.max(high[c], zero) - top);
    }
    return path;
  }
  for (let k = 1; k < x.length; k++) {
    if (y[k] !== y[k] || y[k - 1] !== y[k - 1]) continue;
    const a = at.toX(x[k - 1]), b = at.toX(x[k]), from = at.toY(line.step ? y[k] : y[k - 1]);
    path.moveTo(a, zero); path.lineTo(a, from); path.lineTo(b, at.toY(y[k])); path.lineTo(b, zero); path.closePath();
  }
  return path;
}

// Lowest and highest place, by column of pixels, that a line reaches; where there is none, low > high.
function columnsOf({ x, y, line }, { left, across, toX, toY }) {
  const count = Math.ceil(across);
  const low = new Float32Array(count).fill(Infinity), high = new Float32Array(count).fill(-Infinity);
  const reach = (c, a, b) => {
    const top = Math.min(a, b), foot = Math.max(a, b);
    if (top < low[c]) low[c] = top;
    if (foot > high[c]) high[c] = foot;
  };
  const along = (x0, y0, x1, y1) => {
    const last = Math.min(Math.floor(x1), count - 1), slope = (y1 - y0) / (x1 - x0);
    for (let c = Math.max(Math.floor(x0), 0); c <= last; c++) {
      reach(c, c > x0 ? y0 + slope * (c - x0) : y0, c + 1 < x1 ? y0 + slope * (c + 1 - x0) : y1);
    }
  };
  let x0 = NaN, y0 = NaN;
  for (let k = 0; k < x.length; k++) {
    const x1 = toX(x[k]) - left, y1 = toY(y[k]), upright = line.step ? y1 : y0;
    if (y0 === y0 && y1 === y1) {
      if (upright !== y0) along(x0, y0, x0, upright);
      along(x0, upright, x1, y1);
    }
    x0 = x1; y0 = y1;
  }
  return { low, high };
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
    this.fileSize = [1100, 800];
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
    if (!width || !height) return;
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
    this.fileSize = [1200, 420];
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

  // The main series is drawn last, so on top, where several lie on each other; a legend keeps their order.
  wanted(width, height, asFile = false) {
    const { view, spec } = this, margin = marginsOf(asFile), inner = width - margin.l - margin.r;
    const found = linesOf(view, spec, inner), axis = view.channels[view.axis];
    const front = view.several ? found.toReversed() : found;
    const label = spec.unit ? `${spec.label} in ${spec.unit}` : spec.label;
    return {
      found, width, height, margin, x: view.range, y: heightRange(found, spec), title: spec.title,
      lines: front.sort((a, b) => Number(a.series === view.raised) - Number(b.series === view.raised)).flatMap(drawnLines),
      legend: found.map(({ name, colour: ink, series, line }) => ({ name, ink: colour(ink), dash: series.theory || line.dash ? [4, 3] : [] })),
      xAxis: { space: 80, grid: !view.sections.length, ...(asFile ? { label: `${axis.label} in ${axis.unit}` } : { suffix: `\u202f${axis.unit}` }) },
      yAxis: { space: 26, ...(asFile ? { label } : {}) },
      under: (g, at) => paintSections(view, g, at), zero: paintZero,
      over: spec.bands?.length ? (g, at) => paintBands(view, spec.bands, g, at) : null,
    };
  }

  // Legend that also reads off: name and value at the cursor of each line.
  label({ found }) {
    this.lines = found;
    const key = found.map(one => one.name + one.colour).join("|");
    if (key === this.labelled) return;
    this.labelled = key;
    this.values = found.map(() => element("b"));
    const bands = (this.spec.bands ?? []).map(name => this.view.bands.find(band => band.key === name)).filter(band => band?.rows.length);
    this.legend.replaceChildren(...found.map((one, k) => element("span", {}, swatch(one), `${one.name} `, this.values[k])),
      ...bands.map(band => element("span", {}, element("i", { className: "block", style: `background:var(--${band.colour})` }), band.name)));
    for (const point of this.points) point.remove();
    this.points = found.map(one => element("div", { className: "dot", style: `background:var(--${one.colour})` }));
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
    this.fileSize = [900, 460];
  }
  wanted(width, height, asFile = false) {
    const { view, spec } = this, { edges } = spec;
    const found = view.shown().filter(series => spec.shares[series.name]).map(series => ({ series, name: series.name, colour: series.colour,
      line: { fill: series === view.main ? "area" : "", step: true }, first: 0, end: 2, whole: false,
      x: [edges[0], ...edges, edges[edges.length - 1]], y: [0, spec.shares[series.name][0], ...spec.shares[series.name], 0] }));
    const top = Math.max(1, ...found.flatMap(one => one.y));
    return {
      found, width, height, margin: marginsOf(asFile, true), x: [edges[0], edges[edges.length - 1]], y: [0, 1.08 * top], title: spec.title,
      lines: found.toReversed().flatMap(drawnLines), legend: found.map(one => ({ name: one.name, ink: colour(one.colour) })),
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
