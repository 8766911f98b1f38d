// A canvas's context that writes down what `followDrawing` paints, for who has no browser: polygons, lines and words in
// pixels. Transforms are applied here, and arcs become corners.

const SLICES = 40;

class FilmContext {
  constructor() { this.shapes = []; this.stack = []; this.matrix = [1, 0, 0, 1, 0, 0]; this.parts = []; }
  save() { this.stack.push([this.matrix, this.fillStyle, this.strokeStyle, this.lineWidth, this.font, this.textAlign]); }
  restore() { [this.matrix, this.fillStyle, this.strokeStyle, this.lineWidth, this.font, this.textAlign] = this.stack.pop(); }
  by(a, b, c, d, e, f) {
    const [p, q, r, s, t, u] = this.matrix;
    this.matrix = [p * a + r * b, q * a + s * b, p * c + r * d, q * c + s * d, p * e + r * f + t, q * e + s * f + u];
  }
  translate(x, y) { this.by(1, 0, 0, 1, x, y); }
  scale(x, y) { this.by(x, 0, 0, y, 0, 0); }
  rotate(angle) { const c = Math.cos(angle), s = Math.sin(angle); this.by(c, s, -s, c, 0, 0); }
  at(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return [Math.round(10 * (a * x + c * y + e)) / 10, Math.round(10 * (b * x + d * y + f)) / 10];
  }
  get size() { return Math.hypot(this.matrix[0], this.matrix[1]); }

  beginPath() { this.parts = []; }
  moveTo(x, y) { this.parts.push([this.at(x, y)]); }
  lineTo(x, y) { if (this.parts.length) this.parts[this.parts.length - 1].push(this.at(x, y)); else this.moveTo(x, y); }
  closePath() { const part = this.parts[this.parts.length - 1]; if (part) part.push(part[0]); }
  rect(x, y, w, h) { this.moveTo(x, y); this.lineTo(x + w, y); this.lineTo(x + w, y + h); this.lineTo(x, y + h); this.closePath(); }
  roundRect(x, y, w, h, r) {
    this.parts.push([]);
    for (const [cx, cy, from] of [[x + w - r, y + r, -1], [x + w - r, y + h - r, 0], [x + r, y + h - r, 1], [x + r, y + r, 2]]) {
      for (let k = 0; k <= 6; k++) { const a = (from + k / 6) * Math.PI / 2; this.lineTo(cx + r * Math.cos(a), cy + r * Math.sin(a)); }
    }
    this.closePath();
  }
  ellipse(x, y, a, b, turn, from, to) {
    const end = Math.min(to, from + 2 * Math.PI), count = 36;
    this.parts.push([]);
    for (let k = 0; k <= count; k++) {
      const at = from + (end - from) * k / count;
      this.lineTo(x + a * Math.cos(at), y + b * Math.sin(at));
    }
  }
  arc(x, y, r, from, to) { this.ellipse(x, y, r, r, 0, from, to); }
  clip() {}  // the view clips to its own picture
  clearRect() {}
  createLinearGradient(x0, y0, x1, y1) {
    return { from: y0, to: y1, stops: [], addColorStop(share, ink) { this.stops.push([share, ink]); } };
  }
  // Colours that change downwards, as slices of one colour each.
  fillGradient(x, y, w, h, { from, to, stops }) {
    const colours = stops.map(([share, ink]) => [share, [1, 3, 5].map(k => parseInt(ink.slice(k, k + 2), 16))]);
    const bounds = [y, ...Array.from({ length: SLICES - 1 }, (_, k) => from + (to - from) * (k + 1) / SLICES), y + h];
    for (let k = 0; k < SLICES; k++) {
      if (bounds[k + 1] <= y || bounds[k] >= y + h) continue;
      const share = (k + 0.5) / SLICES, next = Math.max(1, colours.findIndex(([at]) => at >= share));
      const [[a, before], [b, after]] = [colours[next - 1], colours[next]];
      this.fillStyle = `rgb(${before.map((part, c) => Math.round(part + (after[c] - part) * (share - a) / (b - a))).join(",")})`;
      const top = Math.max(bounds[k], y);
      this.fillRect(x, top, w, Math.min(bounds[k + 1], y + h) - top);
    }
  }

  fill() { for (const part of this.parts) if (part.length > 2) this.shapes.push(["fill", this.fillStyle, part]); }
  stroke() { for (const part of this.parts) if (part.length > 1) this.shapes.push(["line", this.strokeStyle, part, this.lineWidth * this.size]); }
  fillRect(x, y, w, h) {
    if (this.fillStyle.stops) { this.fillGradient(x, y, w, h, this.fillStyle); return; }
    this.beginPath(); this.rect(x, y, w, h); this.fill();
  }
  fillText(words, x, y) {
    const [, size] = /(\d+)px/.exec(this.font);
    this.shapes.push(["text", this.fillStyle, this.at(x, y), words, size * this.size, this.textAlign]);
  }
}

function filmOf(columns, spec, width, height) {
  const context = new FilmContext();
  const draw = followDrawing({ width, height, clientWidth: width, getContext: () => context }, () => columns, spec);
  return place => { context.shapes = []; draw(place); return JSON.stringify(context.shapes); };
}
