// Figures for Plotly: specifications only, so that the page and an exported picture come from the same functions.

const LEVELS = 16;
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

function marginsOf(asFile) {
  return asFile ? { l: 72, r: 24, t: 92, b: 60, pad: 0 } : { l: phone() ? 46 : 58, r: 10, t: 16, b: 24, pad: 0 };
}

function axisStyle(extra) {
  return {
    gridcolor: colour("grid"), zerolinecolor: colour("band"), zerolinewidth: 1, linecolor: colour("muted"), showline: false,
    tickfont: { size: 11.5, color: colour("muted") }, ticks: "", exponentformat: "none", separatethousands: true,
    automargin: false, fixedrange: true, ...extra,
  };
}

// Plotly takes tags and entities out of text; names are shown as they are.
const plain = text => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

function layoutOf(asFile, title, extra) {
  const font = { family: colour("font"), color: colour("ink"), size: 12 };
  const top = pixels => 1 - pixels / extra.height, left = { x: 0.012, xanchor: "left", yanchor: "top" };
  return {
    font, paper_bgcolor: asFile ? colour("card") : "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", hovermode: false,
    margin: marginsOf(asFile), separators: ".\u202f", showlegend: asFile,
    legend: { ...left, orientation: "h", xref: "container", yref: "container", y: top(44), font: { size: 12 } },
    ...(asFile ? { title: { ...left, text: plain(title), y: top(16), font: { size: 16 } } } : {}), ...extra,
  };
}

// Lines of a panel within the shown stretch: [{series, line, colour, name, x, y, whole}].
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
  let low = panel.zero ? 0 : Infinity, high = panel.zero ? 0 : -Infinity;
  for (const { column, first, end } of lines) {
    const [below, above] = span(column, first, end);
    low = Math.min(low, below); high = Math.max(high, above);
  }
  if (!(low <= high)) [low, high] = [0, 1];
  const room = Math.max(high - low, panel.least || 1e-9);
  const middle = (low + high) / 2;
  low = Math.min(low, middle - room / 2); high = Math.max(high, middle + room / 2);
  return [low - (low < 0 || !panel.zero ? 0.07 : 0.02) * room, high + 0.09 * room];
}

// Not simplified by Plotly, which leaves out peaks of lines that go up and down within a pixel.
function traceOf(found, panel) {
  const ink = colour(found.colour), { line, x, y } = found;
  const dots = found.whole && found.end - found.first < 120;
  return {
    type: "scatter", mode: dots && !line.fill ? "lines+markers" : "lines", x, y, name: plain(found.name), connectgaps: false,
    line: { color: ink, width: line.fill === "band" ? 0 : found.series.theory ? 1.3 : 1.6, shape: line.step ? "vh" : "linear",
      dash: found.series.theory || line.dash ? "3px,2px" : "solid", simplify: false },
    marker: { size: 4, color: ink }, hoverinfo: "skip",
    ...(line.fill ? { fill: "tozeroy", fillcolor: inkOf(found.colour, line.fill === "band" ? 0.75 : 0.2) } : {}),
  };
}

// Sections as dotted lines with their labels on top; none where they would stand too close.
function sectionMarks(view, width) {
  const [low, high] = view.range, axis = view.main.columns[view.axis], shapes = [], annotations = [];
  const seen = view.sections.filter(s => axis[s.last] > low && axis[s.first] < high);
  if (seen.length > 90) return { shapes, annotations };
  const scale = width / (high - low);
  let labelled = -Infinity;
  for (const section of seen) {
    const begin = axis[section.first], end = axis[section.last];
    const line = { color: colour("band"), width: 1, dash: "dot" };
    if (section.shaded) {
      shapes.push({ type: "rect", xref: "x", yref: "paper", x0: begin, x1: end, y0: 0, y1: 1, layer: "below",
        fillcolor: inkOf("band", 0.22), line: { width: 0 } });
    } else if (begin > low) {
      shapes.push({ type: "line", xref: "x", yref: "paper", x0: begin, x1: begin, y0: 0, y1: 1, layer: "below", line });
    }
    const left = Math.max(begin, low), right = Math.min(end, high), room = 4 + 7 * section.label.length;
    const middle = (left + right) / 2 * scale;
    if ((right - left) * scale > (section.shaded ? 5 : 14) && middle - labelled > room) {
      labelled = middle;
      annotations.push({ x: (left + right) / 2, xref: "x", y: 1, yref: "paper", yanchor: "bottom", text: plain(section.label),
        showarrow: false, font: { size: 10.5, color: colour("muted") }, yshift: -1 });
    }
  }
  return { shapes, annotations };
}

// The main series is drawn last, so on top, where several lie on each other; a legend keeps their order.
const front = (traces, view, asFile) => view.several && !asFile ? traces.reverse() : traces;

function panelFigure(view, panel, width, height, asFile = false) {
  const margin = marginsOf(asFile), inner = width - margin.l - margin.r;
  const lines = linesOf(view, panel, inner), range = heightRange(lines, panel), axis = view.channels[view.axis];
  return {
    lines,
    data: front(lines.map(found => traceOf(found, panel)), view, asFile),
    layout: layoutOf(asFile, panel.title, {
      width, height, ...sectionMarks(view, inner),
      xaxis: axisStyle({
        range: view.range, nticks: Math.max(4, Math.round(inner / 80)), showgrid: !view.sections.length, zeroline: false,
        ...(asFile ? { title: { text: `${axis.label} in ${axis.unit}` } } : { ticksuffix: `\u202f${axis.unit}` }),
      }),
      yaxis: axisStyle({ range, nticks: Math.max(3, Math.round(height / 42)), zeroline: true,
        ...(asFile ? { title: { text: panel.unit ? `${panel.label} in ${panel.unit}` : panel.label } } : {}) }),
    }),
  };
}

// ---- the map --------------------------------------------------------------------------------------------------------

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

function lineTrace(x, y, rows, line, name, showlegend = false) {
  return { type: "scatter", mode: "lines", hoverinfo: "skip", name: plain(name), showlegend, line: { ...line, simplify: false },
    x: rows.map(i => i < 0 ? null : x[i]), y: rows.map(i => i < 0 ? null : y[i]) };
}

// A path in steps of colour: one trace a level, with gaps; neighbours share a point. With `worst` a piece takes the
// largest value inside it, so that no peak is lost.
function colouredTraces(x, y, values, rows, [low, high], name, worst) {
  const levels = Array.from({ length: LEVELS }, () => ({ x: [], y: [] }));
  let last = -1;
  for (let k = 0; k + 1 < rows.length; k++) {
    const i = rows[k], j = rows[k + 1];
    if (i < 0 || j < 0) { last = -1; continue; }
    const value = worst && i < j ? values[Math.max(extremesIn(values, i, j + 1)[1], 0)] : values[j];
    const share = (value - low) / (high - low || 1);
    const level = Math.min(LEVELS - 1, Math.max(0, Math.floor((share === share ? share : 0) * LEVELS))), to = levels[level];
    if (level !== last) { to.x.push(null, x[i]); to.y.push(null, y[i]); }
    to.x.push(x[j]); to.y.push(y[j]);
    last = level;
  }
  return levels.map(({ x, y }, level) => ({ type: "scatter", mode: "lines", hoverinfo: "skip", x, y, name: plain(name), showlegend: false,
    line: { color: colour(`e${level}`), width: 3, simplify: false } })).filter(trace => trace.x.length);
}

const mapGap = (box, width) => 1.2 * (box[1] - box[0]) / Math.max(width, 100);
const MAP_POINTS = 4000;

function mapRows(series, first, end, box, width) {
  const { x, y } = series.columns;
  const across = box[1] - box[0], up = box[3] - box[2];
  const wide = [box[0] - across, box[1] + across, box[2] - up, box[3] + up];
  const rows = pathRows(x, y, first, end, mapGap(box, width), wide);
  const every = Math.ceil(rows.length / MAP_POINTS);
  return every > 1 ? rows.filter((row, k) => row < 0 || k % every === 0) : rows;
}

function mapTraces(view, box, width, asFile) {
  const traces = [], chosen = view.map.chosen, main = view.main;
  for (const line of view.map.lines) {
    const rows = pathRows(line.x, line.y, 0, line.x.length, mapGap(box, width), box.map((v, i) => v + (i % 2 ? 1e4 : -1e4)));
    const style = line.role === "wanted" ? { color: colour("band"), width: asFile ? 6 : 5 } : { color: colour("muted"), width: 1 };
    traces.push(lineTrace(line.x, line.y, rows, style, line.name, line.role === "wanted"));
  }
  for (const series of view.shown().reverse()) {
    if (!series.columns.x || (chosen && series !== main)) continue;
    const { x, y } = series.columns, axis = series.columns[view.axis];
    const first = Math.max(0, rowOf(axis, view.range[0]) - 1), end = Math.min(x.length, rowOf(axis, view.range[1]) + 1);
    if (first > 1 || end < x.length - 1) {
      traces.push(lineTrace(x, y, mapRows(series, 0, x.length, box, width), { color: colour("muted"), width: 1 }, series.name));
    }
    const rows = mapRows(series, first, end, box, width);
    if (chosen) traces.push(...colouredTraces(x, y, view.coloured(), rows, view.colourRange(), series.name, view.channels[chosen].absolute));
    else traces.push(lineTrace(x, y, rows, { color: colour(series.colour), width: 2, dash: series.theory ? "3px,2px" : "solid" }, series.name, true));
  }
  for (const mark of view.map.marks) {
    traces.push({ type: "scatter", mode: "markers", x: mark.x, y: mark.y, name: mark.name, showlegend: true, hoverinfo: "skip",
      marker: { symbol: mark.symbol, size: 9, color: colour(mark.colour), line: { width: 1.5, color: colour(mark.colour) } } });
  }
  return traces;
}

function mapFigure(view, box, width, height, asFile = false) {
  const data = mapTraces(view, box, width, asFile), bare = { showgrid: false, zeroline: false, showticklabels: false };
  const labels = view.map.labels.map(({ x, y, text }) => ({ x, y, text: plain(text), showarrow: false, font: { size: 11, color: colour("muted") } }));
  if (asFile && view.map.chosen) data.push(colourBar(view));
  return {
    data,
    layout: layoutOf(asFile, view.title, {
      width, height, annotations: labels,
      margin: asFile ? { l: 24, r: 90, t: 76, b: 24 } : { l: 0, r: 0, t: 0, b: 0 },
      xaxis: axisStyle({ range: [box[0], box[1]], ...bare }), yaxis: axisStyle({ range: [box[2], box[3]], ...bare }),
    }),
  };
}

function colourBar(view) {
  const channel = view.channels[view.map.chosen], [low, high] = view.colourRange();
  const scale = Array.from({ length: LEVELS }, (_, i) => [[i / LEVELS, colour(`e${i}`)], [(i + 1) / LEVELS, colour(`e${i}`)]]).flat();
  return { type: "scatter", mode: "markers", x: [null], y: [null], showlegend: false,
    marker: { color: [low], cmin: low, cmax: high, colorscale: scale, showscale: true,
      colorbar: { title: { text: `${channel.label}<br>in ${channel.unit}` }, thickness: 14, outlinewidth: 0, len: 0.7 } } };
}

// ---- points of one column over another (g-g diagram) ----------------------------------------------------------------

function cloudFigure(view, cloud, width, height, asFile = false) {
  const data = [];
  for (const series of view.shown()) {
    const x = series.columns[cloud.x], y = series.columns[cloud.y];
    if (!x || !y) continue;
    const every = Math.ceil(x.length / 1500), pick = column => Array.from({ length: Math.ceil(x.length / every) }, (_, k) => column[k * every]);
    data.push({ type: "scatter", mode: "markers", x: pick(x), y: pick(y), name: plain(series.name), hoverinfo: "skip",
      marker: { size: 3.2, color: colour(series.colour), opacity: series.theory ? 0.9 : 0.5 } });
  }
  const margin = asFile ? marginsOf(true) : { ...marginsOf(false), b: 38 };
  const inner = [width - margin.l - margin.r, height - margin.t - margin.b];
  const box = fittedBox(cloud.box, ...inner, 0.05);
  return {
    data,
    layout: layoutOf(asFile, cloud.title, {
      width, height, margin,
      xaxis: axisStyle({ range: [box[0], box[1]], title: { text: cloud.xLabel, font: { size: 12 }, standoff: 4 } }),
      yaxis: axisStyle({ range: [box[2], box[3]], title: { text: cloud.yLabel, font: { size: 12 }, standoff: 4 } }),
    }),
  };
}

// The smallest box with the proportions of the paper that holds the given one, so that both axes have one scale.
function fittedBox([x0, x1, y0, y1], width, height, room) {
  const scale = Math.max((x1 - x0) / width, (y1 - y0) / height, 1e-9) * (1 + 2 * room);
  const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
  return [cx - scale * width / 2, cx + scale * width / 2, cy - scale * height / 2, cy + scale * height / 2];
}
