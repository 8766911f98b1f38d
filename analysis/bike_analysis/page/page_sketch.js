// Quick drawings: a panel's specification for Plotly, drawn on a canvas in about a millisecond while the stretch moves.
//
// Plotly takes tens of milliseconds for the same and draws it when the movement has come to rest. Only what panels use is
// known here. Many rows become one upright bar for each column of pixels, from the lowest to the highest place that the
// line reaches in it: no peak is lost, and bars are filled faster than long lines are stroked.

const FEW_POINTS = 160;  // up to these, lines are stroked

// Draws on the canvas and answers the ticks that it has drawn, [value, text], for both axes.
function sketched(canvas, { data, layout }) {
  const { width, height, margin, xaxis, yaxis } = layout, g = canvas.getContext("2d"), ratio = devicePixelRatio;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const across = width - margin.l - margin.r, down = height - margin.t - margin.b;
  const [west, east] = xaxis.range, [south, north] = yaxis.range;
  const at = { across, down, toX: x => (x - west) / (east - west) * across, toY: y => (north - y) / (north - south) * down };
  const ticks = { x: ticksOf(xaxis), y: ticksOf(yaxis) };
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  g.translate(margin.l, margin.t);
  g.save();
  g.beginPath();
  g.rect(0, 0, across, down);
  g.clip();
  sketchGrid(g, at, layout, ticks);
  for (const trace of data) sketchTrace(g, at, trace);
  g.restore();
  sketchWords(g, at, layout, ticks);
  return ticks;
}

// Places of the ticks as Plotly chooses them: steps of 1, 2 or 5 times a power of ten, not more ticks than wanted.
function ticksOf({ range: [low, high], nticks, ticksuffix = "" }) {
  const rough = (high - low) / nticks, base = 10 ** Math.floor(Math.log10(rough));
  const step = base * ([2, 5].find(times => times * base >= rough) ?? 10), room = 1e-4 * (high - low);
  const digits = Math.max(0, 2 - Math.floor(Math.log10(step) + 0.01)), ticks = [];
  for (let k = Math.ceil((low - room) / step); k * step <= high + room; k++) {
    ticks.push([k * step, tickText(k * step, digits) + ticksuffix]);
  }
  return ticks;
}
function tickText(value, digits) {
  const [whole, part = ""] = Math.abs(value).toFixed(digits).split("."), rest = part.replace(/0+$/, "");
  return (value < 0 ? "−" : "") + whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") + (rest && `.${rest}`);
}

function sketchGrid(g, { across, down, toX, toY }, { xaxis, yaxis, shapes }, ticks) {
  const upright = (x, ink) => { g.fillStyle = ink; g.fillRect(Math.round(x - 0.5), 0, 1, down); };
  const level = (y, ink) => { g.fillStyle = ink; g.fillRect(0, Math.round(y - 0.5), across, 1); };
  for (const { type, x0, x1, fillcolor, line } of shapes) {
    if (type === "rect") { g.fillStyle = fillcolor; g.fillRect(toX(x0), 0, toX(x1) - toX(x0), down); continue; }
    Object.assign(g, { strokeStyle: line.color, lineWidth: line.width });
    g.setLineDash([3, 3]);
    stroke(g, [[toX(x0), down], [toX(x0), 0]]);
  }
  if (xaxis.showgrid !== false) for (const [x] of ticks.x) upright(toX(x), xaxis.gridcolor);
  for (const [y] of ticks.y) if (y !== 0 && toY(y) > 1 && toY(y) < down - 1) level(toY(y), yaxis.gridcolor);
  if (yaxis.range[0] <= 0 && yaxis.range[1] >= 0) level(toY(0), yaxis.zerolinecolor);
}

function sketchWords(g, { across, down, toX, toY }, { font, xaxis, yaxis, margin, annotations }, ticks) {
  const write = (text, x, y, size, ink) => {
    g.font = `${size}px ${font.family}`;
    g.fillStyle = ink;
    g.fillText(text, x, y);
  };
  const { size, color } = xaxis.tickfont;
  g.font = `${size}px ${font.family}`;
  const fits = (x, text) => {
    const half = g.measureText(text).width / 2;
    return x - half >= -margin.l && x + half <= across + margin.r;
  };
  g.textAlign = "center";
  ticks.x = ticks.x.filter(([x, text]) => fits(toX(x), text));
  for (const [x, text] of ticks.x) write(text, toX(x), down + 12.5, size, color);
  for (const { x, text, font: own } of annotations) write(text, toX(x), -3, own.size, own.color);
  g.textAlign = "right";
  for (const [y, text] of ticks.y) write(text, -1, toY(y) + 0.35 * size, yaxis.tickfont.size, yaxis.tickfont.color);
}

function stroke(g, points) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.stroke();
}

function sketchTrace(g, at, trace) {
  const { line, fill, fillcolor } = trace, zero = at.toY(0);
  if (trace.x.length <= FEW_POINTS) { strokeTrace(g, at, trace, zero); return; }
  const { low, high } = columnsOf(trace, at), count = low.length;
  if (fill) {
    g.fillStyle = fillcolor;
    for (let c = 0; c < count; c++) {
      const top = Math.min(low[c], zero);
      if (low[c] <= high[c]) g.fillRect(c, top, 1, Math.max(high[c], zero) - top);
    }
  }
  if (!line.width) return;
  g.fillStyle = line.color;
  const dashed = line.dash !== "solid", half = line.width / 2;
  for (let c = 0; c < count; c++) {
    if (low[c] > high[c] || (dashed && c % 5 > 2)) continue;
    g.fillRect(c + 0.5 - half, low[c] - half, line.width, high[c] - low[c] + line.width);
  }
}

// Lowest and highest place in pixels, by column of pixels, that a line reaches; where there is none, low > high.
function columnsOf({ x, y, line }, { across, toX, toY }) {
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
    const x1 = toX(x[k]), y1 = toY(y[k]), upright = line.shape === "vh" ? y1 : y0;
    if (y0 === y0 && y1 === y1) {
      if (upright !== y0) along(x0, y0, x0, upright);
      along(x0, upright, x1, y1);
    }
    x0 = x1; y0 = y1;
  }
  return { low, high };
}

// Few points: lines, areas and dots as Plotly draws them, broken where a value is missing.
function strokeTrace(g, { toX, toY }, { x, y, line, mode, marker, fill, fillcolor }, zero) {
  let piece = [];
  const pieces = [piece];
  for (let k = 0; k < x.length; k++) {
    if (y[k] !== y[k]) { pieces.push(piece = []); continue; }
    const point = [toX(x[k]), toY(y[k])], before = piece[piece.length - 1];
    if (line.shape === "vh" && before) piece.push([before[0], point[1]]);
    piece.push(point);
  }
  Object.assign(g, { strokeStyle: line.color, lineWidth: line.width, lineJoin: "round" });
  g.setLineDash(line.dash === "solid" ? [] : [3, 2]);
  for (const points of pieces.filter(found => found.length)) {
    if (fill) {
      g.fillStyle = fillcolor;
      g.beginPath();
      for (const [px, py] of [[points[0][0], zero], ...points, [points[points.length - 1][0], zero]]) g.lineTo(px, py);
      g.fill();
    }
    if (line.width) stroke(g, points);
    if (!mode.includes("markers")) continue;
    g.fillStyle = marker.color;
    for (const [px, py] of points) { g.beginPath(); g.arc(px, py, marker.size / 2, 0, 2 * Math.PI); g.fill(); }
  }
}
