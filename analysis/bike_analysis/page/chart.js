// Columns of numbers as `html.py` embeds them, and what is drawn of them.

const MISSING = -(2 ** 31);

function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

// A column holds multiples of a quantum: zigzag differences, split into four planes of bytes, deflated.
async function decoded(column) {
  const stream = new Blob([bytesOf(column.data)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const n = column.rows, values = new Float64Array(n);
  for (let i = 0, sum = 0; i < n; i++) {
    const z = bytes[i] | bytes[n + i] << 8 | bytes[2 * n + i] << 16 | bytes[3 * n + i] << 24;
    sum = (sum + ((z >>> 1) ^ -(z & 1))) | 0;
    values[i] = sum === MISSING ? NaN : sum * column.quantum;
  }
  return values;
}

async function decodedAll(columns) {
  const names = Object.keys(columns), values = await Promise.all(names.map(name => decoded(columns[name])));
  return Object.fromEntries(names.map((name, i) => [name, values[i]]));
}

// First row whose value is not below `wanted`, in a column that never falls.
function rowOf(column, wanted) {
  let low = 0, high = column.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (column[middle] < wanted) low = middle + 1; else high = middle;
  }
  return low;
}

function nearestRow(column, wanted) {
  const row = Math.min(rowOf(column, wanted), column.length - 1);
  return row > 0 && wanted - column[row - 1] < column[row] - wanted ? row - 1 : row;
}

// Rows of the smallest and the largest value in [first, end); -1 where all are missing.
function extremeRows(column, first, end) {
  let low = -1, high = -1;
  for (let i = first; i < end; i++) {
    const value = column[i];
    if (value !== value) continue;
    if (low < 0 || value < column[low]) low = i;
    if (high < 0 || value > column[high]) high = i;
  }
  return [low, high];
}

// The line as drawn: everything where there are few rows, else the extremes of each stretch of so many rows that there are
// at most `cells` stretches, so no peak is lost. They lie fast in the column, so nothing flickers in a pan.
function thinned(x, y, first, end, cells) {
  if (end - first <= 2 * cells) return { x: x.subarray(first, end), y: y.subarray(first, end), whole: true };
  const size = 2 ** Math.ceil(Math.log2((end - first) / cells)), rows = [first];
  for (let from = first, to; from < end; from = to) {
    to = Math.min((Math.floor(from / size) + 1) * size, end);
    const [low, high] = extremeRows(y, from, to);
    if (low < 0) rows.push(from); else rows.push(Math.min(low, high), Math.max(low, high));
  }
  rows.push(end - 1);
  return { x: rows.map(row => x[row]), y: rows.map(row => y[row]), whole: false };
}

// Smallest and largest value, of a whole column kept.
function ends(column) {
  const [low, high] = extremeRows(column, 0, column.length);
  return low < 0 ? [0, 1] : [column[low], column[high]];
}
const spans = new WeakMap();
function span(column) {
  if (!spans.has(column)) spans.set(column, ends(column));
  return spans.get(column);
}

// A column less another one that is interpolated at the same places; missing beyond the other's ends.
function minus(places, values, otherPlaces, otherValues) {
  const last = otherPlaces.length - 1, result = new Float64Array(places.length);
  for (let i = 0, k = 0; i < places.length; i++) {
    const at = places[i];
    while (k < last - 1 && otherPlaces[k + 1] < at) k++;
    const from = otherPlaces[k], share = (at - from) / (otherPlaces[k + 1] - from || 1);
    result[i] = at < otherPlaces[0] || at > otherPlaces[last] ? NaN
      : values[i] - otherValues[k] - share * (otherValues[k + 1] - otherValues[k]);
  }
  return result;
}

// Pointers on a drawing: events of mouse, pen and fingers as hover, pan, zoom, select and reset.
//
// Mouse: moving hovers; dragging selects (with shift, or where nothing is to be selected, it pans); control and wheel
// zoom, as does pinching a trackpad; a double click resets. Fingers: one hovers, two pan and zoom; the page still
// scrolls up and down.

function listenTo(area, on) {
  const fingers = new Map();
  let drag = null;
  const place = event => {
    const box = area.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const between = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

  function pinch(id, now) {
    const before = fingers.get(id);
    const other = [...fingers].find(([key]) => key !== id)[1];
    on.pan(now[0] / 2 - before[0] / 2, now[1] / 2 - before[1] / 2);
    on.zoom(Math.max(between(before, other), 20) / Math.max(between(now, other), 20),
      [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
  }

  area.addEventListener("pointerdown", event => {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    area.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
    const touch = event.pointerType === "touch";
    drag = fingers.size > 1 ? null : { from: place(event), touch, pan: event.shiftKey || !on.select };
    if (touch && fingers.size === 1) on.hover(place(event));
  });
  area.addEventListener("pointermove", event => {
    const now = place(event), before = fingers.get(event.pointerId);
    if (!before) on.hover(now);
    else if (fingers.size === 2) pinch(event.pointerId, now);
    else if (drag?.touch) on.hover(now);
    else if (drag?.pan) on.pan(now[0] - before[0], now[1] - before[1]);
    else if (drag) on.select(drag.from, now, false);
    if (before) fingers.set(event.pointerId, now);
  });
  const release = (event, done) => {
    if (!fingers.delete(event.pointerId)) return;
    const now = place(event);
    if (drag && !drag.touch && !drag.pan) on.select(drag.from, done && between(drag.from, now) > 5 ? now : null, true);
    drag = null;
  };
  area.addEventListener("pointerup", event => release(event, true));
  area.addEventListener("pointercancel", event => release(event, false));
  area.addEventListener("dblclick", on.reset);
  area.addEventListener("wheel", event => {
    if (event.ctrlKey || event.metaKey) on.zoom(Math.exp(event.deltaY * 0.004), place(event));
    else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) on.pan(-event.deltaX, 0);
    else return;
    event.preventDefault();
  }, { passive: false });
}

// The one way in which plots are drawn: uPlot draws axes, grid and lines on a canvas, and what it has no word for is
// painted on the same canvas under and over them. A saved picture is drawn by the same calls.

const narrow = matchMedia("(max-width: 46rem)");
const phone = () => narrow.matches;

// Colours and font of the style sheet, asked for once: each question has the browser look at all styles.
const colours = new Map();
function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return colours.get(name);
}
function inkOf(name, opacity) {
  const hex = colour(name), part = i => parseInt(hex.slice(i, i + 2), 16);
  return `rgba(${part(1)},${part(3)},${part(5)},${opacity})`;
}

function marginsOf(asFile, labelled = false) {
  if (asFile) return { l: 78, r: 24, t: 92, b: 56 };
  return { l: phone() ? 46 : 58, r: 10, t: 16, b: labelled ? 40 : 24 };
}

const grouped = (value, digits) => {
  const [whole, part] = Math.abs(value).toFixed(digits).split(".");
  return (value < 0 && Number(value.toFixed(digits)) ? "−" : "") + whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") + (part ? `.${part}` : "");
};
function tickTexts(ticks, increment, suffix = "") {
  let digits = Math.max(0, -Math.floor(Math.log10(increment) + 1e-9));
  const whole = increment * 10 ** digits;
  if (Math.abs(whole - Math.round(whole)) > 1e-6) digits += 1;  // steps of 2.5
  return ticks.map(value => value === null ? "" : grouped(value, Math.min(digits, 6)) + suffix);
}

// A plot. `show` takes what is wanted:
//   width, height, margin; x, y: ends of the axes; lines: [{ x, y, ink, fill, width, dash, dots, path }], where path is one
//   of uPlot's; xAxis, yAxis: { space, suffix, label, grid } or null; under(g, at), over(g, at): what is painted
//   below the grid and above the lines; title, legend: of a saved picture.
// `at` tells places on the canvas: left, top, across, down, ratio, toX, toY.
class Chart {
  constructor(host) { this.host = host; }

  show(wanted) {
    this.wanted = wanted;
    const { margin, width, height, lines, x, y } = wanted, axes = [wanted.xAxis, wanted.yAxis];
    const kind = JSON.stringify([margin, lines.map(line => [line.width, line.dash]), axes.map(axis => axis && axis.label)]);
    const data = lines.length ? [null, ...lines.map(line => [line.x, line.y])] : [[0, 1]];  // uPlot's mode 2 needs a line
    if (kind !== this.kind) {
      this.kind = kind;
      this.u?.destroy();
      this.u = new uPlot(this.options(), data, this.host);
    }
    this.u.batch(u => {
      u.setData(data, false);
      if (u.width !== width || u.height !== height) u.setSize({ width, height });
      u.redraw(true, true);  // first, as it asks for the scale as it was
      u.setScale("x", { min: x[0], max: x[1] });
      u.setScale("y", { min: y[0], max: y[1] });
    });
  }

  // Styles are functions of what is wanted now, so that a plot lives on when its lines change their colours or ends.
  options() {
    const { margin, width, height, lines } = this.wanted, font = `12px ${colour("font")}`;
    const axis = (name, side, size) => {
      const own = () => this.wanted[name];
      if (!own()) return { show: false };
      const { label } = own();
      return {
        side, font, labelFont: font, label, labelSize: label ? 20 : 0, size: label ? size - 20 : size, gap: side === 2 ? 4 : 6,
        stroke: () => colour("muted"), space: () => own().space, ticks: { show: false },
        grid: { stroke: () => own().grid === false ? "transparent" : colour("grid"), width: 1 },
        values: (u, ticks, _, __, increment) => this.fitting(u, ticks, tickTexts(ticks, increment, own().suffix), side),
      };
    };
    const line = (_, k) => {
      const now = () => this.wanted.lines[k], ink = () => now().ink;
      return {
        stroke: ink, fill: () => now().fill, fillTo: 0, width: lines[k].width, dash: lines[k].dash, pxAlign: 0,
        points: { show: () => now().dots, size: 4, width: 0, fill: ink }, paths: (...places) => now().path(...places),
        facets: [{ scale: "x" }, { scale: "y" }],
      };
    };
    const painted = name => u => {
      const paint = this.wanted[name];
      if (!paint) return;
      const at = placesOf(u), g = u.ctx;
      g.save();
      paint(g, at);
      g.restore();
    };
    return {
      mode: lines.length ? 2 : 1, width, height, padding: [margin.t, margin.r, this.wanted.xAxis ? 0 : margin.b, this.wanted.yAxis ? 0 : margin.l],
      legend: { show: false }, cursor: { show: false }, pxAlign: 1,
      scales: { x: { time: false, auto: false, range: (u, low, high) => this.wanted.x },
        y: { auto: false, range: () => this.wanted.y } },
      axes: [axis("xAxis", 2, margin.b), axis("yAxis", 3, margin.l)],
      series: [lines.length ? null : {}, ...lines.map(line)],
      hooks: { drawClear: [painted("head"), painted("under")], drawAxes: [painted("zero")], draw: [painted("over")] },
    };
  }

  // Words of ticks whose ends would be cut off at the plot's edge are left out.
  fitting(u, ticks, texts, side) {
    if (side !== 2) return texts;
    const { margin, width, x: [low, high] } = this.wanted, across = width - margin.l - margin.r;
    return texts.map((text, k) => {
      const middle = margin.l + (ticks[k] - low) / (high - low) * across, half = 3.4 * text.length;
      return middle - half < 0 || middle + half > width ? "" : text;
    });
  }
}

function placesOf(u) {
  const { left, top, width: across, height: down } = u.bbox, { x, y } = u.scales;
  return { left, top, across, down, ratio: devicePixelRatio,
    toX: value => left + (value - x.min) / (x.max - x.min) * across, toY: value => top + (y.max - value) / (y.max - y.min) * down };
}

// ---- painting -------------------------------------------------------------------------------------------------------

function clipTo(g, { left, top, across, down }) {
  g.beginPath();
  g.rect(left, top, across, down);
  g.clip();
}
function writeAt(g, { ratio }, text, x, y, size, ink, align = "center", weight = "") {
  g.font = `${weight} ${size * ratio}px ${colour("font")}`.trim();
  Object.assign(g, { fillStyle: ink, textAlign: align, textBaseline: "alphabetic" });
  g.fillText(text, x, y);
}
function strokeRows(g, at, x, y, rows, ink, width, dash = []) {
  g.beginPath();
  let pen = false;
  for (const row of rows) {
    if (row < 0) { pen = false; continue; }
    if (pen) g.lineTo(at.toX(x[row]), at.toY(y[row])); else g.moveTo(at.toX(x[row]), at.toY(y[row]));
    pen = true;
  }
  strokeNow(g, at, ink, width, dash);
}
function strokeNow(g, { ratio }, ink, width, dash = []) {
  Object.assign(g, { strokeStyle: ink, lineWidth: width * ratio, lineJoin: "round" });
  g.setLineDash(dash.map(part => part * ratio));
  g.stroke();
  g.setLineDash([]);
}

function paintSymbol(g, at, symbol, x, y, size, ink) {
  const r = size / 2 * at.ratio, px = at.toX(x), py = at.toY(y);
  const corners = { "triangle-up": [[0, -1.2], [1.05, 0.8], [-1.05, 0.8]], square: [[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]] }[symbol];
  g.beginPath();
  if (corners) {
    corners.forEach(([u, v], k) => k ? g.lineTo(px + u * r, py + v * r) : g.moveTo(px + u * r, py + v * r));
    g.closePath();
    g.fillStyle = ink;
    g.fill();
  } else if (symbol === "x-thin") {
    for (const turn of [1, -1]) { g.moveTo(px - r, py - turn * r); g.lineTo(px + r, py + turn * r); }
    strokeNow(g, at, ink, 2);
  } else {
    g.arc(px, py, r, 0, 2 * Math.PI);
    strokeNow(g, at, ink, 1.5);
  }
}

// Title and legend of a saved picture; on the page they stand beside it as text.
function paintHead({ title, legend = [] }) {
  return (g, at) => {
    const { ratio } = at, x0 = 14 * ratio;
    g.fillStyle = colour("card");
    g.fillRect(0, 0, at.left + at.across + 400 * ratio, at.top + at.down + 400 * ratio);
    writeAt(g, at, title, x0, 30 * ratio, 16, colour("ink"), "left", "600");
    let x = x0, y = 56 * ratio;
    for (const { name, ink, dash = [] } of legend) {
      const wide = 34 * ratio + g.measureText(name).width;
      if (x > x0 && x + wide > at.left + at.across) { x = x0; y += 18 * ratio; }
      g.beginPath();
      g.moveTo(x, y - 4 * ratio); g.lineTo(x + 18 * ratio, y - 4 * ratio);
      strokeNow(g, at, ink, 3, dash);
      writeAt(g, at, name, x + 24 * ratio, y, 12, colour("ink"), "left");
      x += 34 * ratio + g.measureText(name).width + 8 * ratio;
    }
  };
}

// ---- saving ---------------------------------------------------------------------------------------------------------

// Once more on a canvas of its own, with title and legend, larger than on the page.
async function save(view, part) {
  const [width, height] = part.fileSize, host = document.createElement("div");
  const wanted = { ...part.wanted(width, height, true), width, height }, chart = new Chart(host);
  chart.show({ ...wanted, head: paintHead(wanted) });
  await new Promise(requestAnimationFrame);  // uPlot draws when the task has ended
  const file = await new Promise(done => chart.u.ctx.canvas.toBlob(done, "image/png"));
  chart.u.destroy();
  const name = `${fileName(`${view.title} ${part.figure.dataset.plot}`)}.png`;
  const link = element("a", { href: URL.createObjectURL(file), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 30000);
}
const fileName = words => words.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(-100);
