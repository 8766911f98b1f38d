// The ride seen from behind, drawn from the view's own columns. x forward, y left; roll positive leaning right.

// Makes the function that draws the ride at a place (a row, or between two rows) on a canvas.
// `columns` answers those of now: a running ride has more of them each time; `ghosts` those of others with their rows at
// the same time.
function followDrawing(canvas, columns, ghosts, { title, lapTime, edges, line, step, open = false, unit = "km/h", machine: kind = "superbike" }) {
  const g = canvas.getContext("2d"), W = canvas.width, H = canvas.height;
  let ride = columns();
  const BACK = 5.6, UP = 2.2, FOCAL = 640, NEAR = 1.0, FAR = kind === "bicycle" ? 120 : 420, HORIZON = H * 0.42;
  const CAMERA_LAG = 0.04;                                             // s, between the headings that the camera follows
  const [lx, ly, rx, ry] = edges, E = lx.length;

  const mix = (a, b, u) => a + u * (b - a);
  function at(column, k) {
    const i = Math.max(0, Math.min(Math.floor(k), column.length - 2));
    return mix(column[i], column[i + 1], k - i);
  }

  const rollAt = k => at(ride.roll, k) * Math.PI / 180;

  // The camera looks along a heading that follows the machine's with a little lag, from behind and above.
  function cameraAt(k) {
    const N = ride.x.length, lag = Math.max(1, Math.round(CAMERA_LAG * N / (ride.time[N - 1] - ride.time[0] || 1)));
    let yaw = 0, weight = 0;
    for (let j = 0; j < 12; j++) {
      const w = Math.exp(-j / 4);
      yaw += w * at(ride.yaw, Math.max(0, k - j * lag)); weight += w;
    }
    yaw /= weight;
    const x = at(ride.x, k), y = at(ride.y, k), c = Math.cos(yaw), s = Math.sin(yaw);
    return { x: x - BACK * c, y: y - BACK * s, c, s, tilt: 0.22 * rollAt(k) };
  }
  // Pixels of a point and its depth; what is nearer than NEAR lies far below the picture.
  function project(cam, [x, y]) {
    const dx = x - cam.x, dy = y - cam.y, depth = cam.c * dx + cam.s * dy, ahead = Math.max(depth, NEAR);
    return [W / 2 - FOCAL * (cam.c * dy - cam.s * dx) / ahead, HORIZON + FOCAL * UP / ahead, depth];
  }
  // A strip between two polylines; all of one colour is one path, which is filled much sooner than many.
  function strip(cam, left, right, first, last, colour) {
    const quads = new Map();
    if (open) { first = Math.max(first, 0); last = Math.min(last, E - 1); }
    for (let k = last - 1; k >= first; k--) {
      const i = wrapped(k), j = wrapped(k + 1), ink = colour(k);
      const quad = [left[i], left[j], right[j], right[i]].map(point => project(cam, point));
      if (quad.every(corner => corner[2] < NEAR)) continue;
      if (!quads.has(ink)) quads.set(ink, []);
      quads.get(ink).push(quad);
    }
    for (const [ink, shapes] of quads) fill(ink, shapes);
  }
  function fill(ink, shapes) {
    g.fillStyle = ink;
    g.beginPath();
    for (const shape of shapes) { shape.forEach(([x, y], k) => k ? g.lineTo(x, y) : g.moveTo(x, y)); g.closePath(); }
    g.fill();
  }
  const wrapped = k => ((k % E) + E) % E;
  const across = lx.map((x, i) => [rx[i] - x, ry[i] - ly[i]]), width = across.reduce((sum, d) => sum + Math.hypot(...d), 0) / E;
  // A polyline so many metres to the right of the left limit; `from` 1 counts from the right one.
  const beside = (metres, from = 0) => across.map(([dx, dy], i) => [lx[i] + (from + metres / width) * dx, ly[i] + (from + metres / width) * dy]);
  const bend = lx.map((_, i) => {
    const [p, n] = [wrapped(i - 3), wrapped(i + 3)], turn = Math.atan2(ly[n] - ly[i], lx[n] - lx[i]) - Math.atan2(ly[i] - ly[p], lx[i] - lx[p]);
    return Math.abs(Math.atan2(Math.sin(turn), Math.cos(turn)));
  });
  const kerb = q => kind === "superbike" && bend[wrapped(q)] > 0.04 ? (q % 2 ? "#d8412f" : "#f3f3f3") : "#6f8a4e";
  const grass = q => q % 4 < 2 ? "#5f7f45" : "#66884b", white = () => "#e8e8e8";
  const strips = [
    [beside(-14), beside(0), grass], [beside(14, 1), beside(0, 1), grass], [beside(0), beside(0, 1), q => q % 6 < 3 ? "#4a4e55" : "#4d5158"],
    [beside(-0.9), beside(0), kerb], [beside(0.9, 1), beside(0, 1), kerb], [beside(0), beside(0.16), white], [beside(0, 1), beside(-0.16, 1), white],
  ];

  function road(cam, k) {
    const s = Math.floor(at(ride.distance, Math.floor(k)) / step), last = s + Math.floor(FAR / step);
    for (const [left, right, colour] of strips) strip(cam, left, right, s - 4, last, colour);
    if (!line.length) return;
    Object.assign(g, { strokeStyle: "rgba(120,200,255,.55)", lineWidth: 2 });
    g.beginPath();
    for (let q = s + 1, pen = false; q < (open ? Math.min(last, E) : last); q++) {
      const [x, y, depth] = project(cam, [line[0][wrapped(q)], line[1][wrapped(q)]]);
      if (depth < NEAR) { pen = false; continue; }
      if (pen) g.lineTo(x, y); else g.moveTo(x, y);
      pen = true;
    }
    g.stroke();
  }

  // Machine and rider from behind, in metres: u to the right, v up, about the contact point.
  function machine(cam, rider, k, alpha = 1) {
    const [x, y, depth] = project(cam, [at(rider.x, k), at(rider.y, k)]);
    if (depth < NEAR || depth > FAR) return;
    const m = FOCAL / depth, roll = at(rider.roll, k) * Math.PI / 180, steer = (rider.steer ? at(rider.steer, k) : 0) * Math.PI / 180;
    g.save();
    g.globalAlpha = alpha;
    g.translate(x, y);
    g.scale(m, m);
    const shape = (colour, points) => fill(colour, [points.map(([u, v]) => [u, -v])]);
    const disc = (colour, u, v, a, b) => { g.fillStyle = colour; g.beginPath(); g.ellipse(u, -v, a, b, 0, 0, 7); g.fill(); };
    const limb = (colour, width, ...points) => {
      Object.assign(g, { strokeStyle: colour, lineWidth: width, lineCap: width > 0.05 ? "round" : "butt" });
      g.beginPath();
      for (const [u, v] of points) g.lineTo(u, -v);
      g.stroke();
    };
    disc("rgba(0,0,0,.35)", 0.3 * Math.sin(roll), 0, 0.3 + 0.5 * Math.abs(Math.sin(roll)), 0.07);
    g.rotate(roll);
    if (kind === "bicycle") bicycle(shape, disc, limb, steer); else superbike(shape, disc, limb, Math.max(-1, Math.min(1, roll / 0.87)));
    g.restore();
  }
  function superbike(shape, disc, limb, hang) {
    const q = 0.2 * hang;
    disc("#15171a", 0, 0.32, 0.10, 0.32);                                              // rear tyre
    disc("#2b2e33", 0, 0.32, 0.05, 0.22);
    shape("#8f1a12", [[-0.15, 0.42], [0.15, 0.42], [0.25, 0.75], [0.21, 0.98], [-0.21, 0.98], [-0.25, 0.75]]); // fairing
    shape("#c8261a", [[-0.11, 0.55], [0.11, 0.55], [0.14, 0.92], [-0.14, 0.92]]);      // tail
    shape("#ffce45", [[-0.06, 0.78], [0.06, 0.78], [0.05, 0.84], [-0.05, 0.84]]);      // number
    limb("#22252a", 0.05, [-0.33, 0.93], [0.33, 0.93]);                                // bars
    shape("#1f4f8f", [[-0.17 + q, 0.80], [0.17 + q, 0.80], [0.25 + 1.3 * q, 1.22], [0.12 + 1.6 * q, 1.36],
      [-0.12 + 1.6 * q, 1.36], [-0.25 + 1.3 * q, 1.22]]);                              // back
    for (const side of [-1, 1]) {
      const out = Math.max(0, side * hang);
      shape("#173a69", [[0.12 * side + q, 0.84], [(0.24 + 0.3 * out) * side + q, 0.60 - 0.1 * out], [0.17 * side, 0.42],
        [0.10 * side, 0.66]]);                              // legs
    }
    for (const side of [-1, 1]) limb("#1f4f8f", 0.09, [0.22 * side + 1.3 * q, 1.18], [0.37 * side + 0.5 * q, 1.04], [0.31 * side, 0.94]);
    disc("#e9ebee", 1.9 * q, 1.45, 0.135, 0.15);                                       // helmet
    disc("#c8261a", 1.9 * q, 1.49, 0.05, 0.11);
  }
  // A bicycle and its rider, who sits still.
  function bicycle(shape, disc, limb, steer) {
    disc("#15171a", 0, 0.3, 0.025, 0.3);                                               // rear tyre
    limb("#22252a", 0.035, [-0.28 * Math.cos(steer), 0.98], [0.28 * Math.cos(steer), 0.98]);  // bars
    shape("#0b66ad", [[-0.02, 0.3], [0.02, 0.3], [0.02, 0.85], [-0.02, 0.85]]);        // frame
    shape("#22252a", [[-0.1, 0.85], [0.1, 0.85], [0.06, 0.91], [-0.06, 0.91]]);        // saddle
    for (const side of [-1, 1]) limb("#39424d", 0.11, [0.08 * side, 0.9], [0.13 * side, 0.3]);
    shape("#1f8f6b", [[-0.14, 0.88], [0.14, 0.88], [0.21, 1.38], [-0.21, 1.38]]);      // back
    for (const side of [-1, 1]) limb("#1f8f6b", 0.08, [0.2 * side, 1.32], [0.27 * side, 1.0]);
    disc("#e9ebee", 0, 1.55, 0.11, 0.13);                                              // helmet
    disc("#0b66ad", 0, 1.6, 0.06, 0.07);
  }

  function text(words, x, y, size, colour = "#fff", align = "left", weight = 600) {
    g.font = `${weight} ${size}px system-ui, sans-serif`; g.fillStyle = colour; g.textAlign = align; g.fillText(words, x, y);
  }
  function panel(x, y, w, h) { g.fillStyle = "rgba(12,15,20,.62)"; g.beginPath(); g.roundRect(x, y, w, h, 10); g.fill(); }

  function instruments(k) {
    const speed = at(ride.speed, k), roll = rollAt(k), share = column => column ? at(column, k) / 100 : 0;
    const H = 204;                                                        // below the title, out of the machine's way
    panel(16, H - 116, 400, 100);
    const fast = unit === "km/h";
    text(fast ? String(Math.round(speed)) : speed.toFixed(1), 130, H - 48, 52, "#fff", "right", 700); text(unit, 138, H - 48, 16, "#b8c2cf");
    const cx = 258, cy = H - 40, r = 54;
    g.lineWidth = 6; g.strokeStyle = "#3a434e"; g.beginPath(); g.arc(cx, cy, r, -Math.PI * 5 / 6, -Math.PI / 6); g.stroke();
    g.strokeStyle = Math.abs(roll) > 0.87 ? "#ff8c5a" : "#62b0f4"; g.beginPath();
    g.arc(cx, cy, r, -Math.PI / 2 + Math.min(0, roll), -Math.PI / 2 + Math.max(0, roll)); g.stroke();
    text(`${Math.round(Math.abs(roll) * 57.2958)}°`, cx, cy + 4, 28, "#fff", "center", 700);
    text("lean", cx, cy + 22, 13, "#b8c2cf", "center");
    if (ride.gear) text(`gear ${ride.gear[Math.round(k)] || "–"}`, 138, H - 90, 16, "#ffce45");
    if (ride.engine) text(`${(at(ride.engine, k) / 1000).toFixed(1)}k rpm`, 138, H - 70, 13, "#b8c2cf");
    if (ride.throttle) for (const [i, value, colour, name] of [[0, share(ride.throttle), "#43c9a3", "gas"], [1, share(ride.brake), "#ff5a48", "brake"]]) {
      const x = 336 + 40 * i;
      g.fillStyle = "#2c333c"; g.fillRect(x, H - 106, 20, 66);
      g.fillStyle = colour; g.fillRect(x, H - 40 - 66 * value, 20, 66 * value);
      text(name, x + 10, H - 24, 13, "#b8c2cf", "center");
    }
    panel(16, 16, 400, 64);
    text(title, 30, 42, 16, "#dfe6ee");
    text(timeText(at(ride.time, k)), 30, 68, 20, "#fff", "left", 700);
    if (lapTime) text(`lap ${lapTime}`, 400, 68, 15, "#b8c2cf", "right");
  }

  const box = { x0: Math.min(...lx, ...rx), x1: Math.max(...lx, ...rx), y0: Math.min(...ly, ...ry), y1: Math.max(...ly, ...ry) };
  const size = 190, scale = size / Math.max(box.x1 - box.x0, box.y1 - box.y0);
  const mapX = x => W - 16 - size + (x - box.x0) * scale - 8, mapY = y => 24 + (box.y1 - y) * scale;
  function map(k) {
    panel(W - size - 34, 12, size + 22, (box.y1 - box.y0) * scale + 26);
    g.strokeStyle = "#cfd6de"; g.lineWidth = 2.5; g.beginPath();
    for (let i = 0; i < E + (open ? 0 : 1); i++) { const j = i % E, x = mapX((lx[j] + rx[j]) / 2), y = mapY((ly[j] + ry[j]) / 2); i ? g.lineTo(x, y) : g.moveTo(x, y); }
    g.stroke();
    g.fillStyle = "#ff5a48"; g.beginPath(); g.arc(mapX(at(ride.x, k)), mapY(at(ride.y, k)), 5, 0, 7); g.fill();
  }

  function draw(k) {
    ride = columns();
    const cam = cameraAt(k);
    g.save();
    g.scale(canvas.width / W, canvas.height / H);
    g.clearRect(0, 0, W, H);
    g.save();
    g.beginPath(); g.rect(0, 0, W, H); g.clip();
    g.translate(W / 2, H * 0.62); g.rotate(-cam.tilt); g.scale(1.16, 1.16); g.translate(-W / 2, -H * 0.62);
    const sky = g.createLinearGradient(0, -H, 0, HORIZON);
    sky.addColorStop(0, "#4d86c6"); sky.addColorStop(1, "#cfe3f2");
    g.fillStyle = sky; g.fillRect(-W, -2 * H, 3 * W, 2 * H + HORIZON);
    const ground = g.createLinearGradient(0, HORIZON, 0, H);
    ground.addColorStop(0, "#9bb27f"); ground.addColorStop(0.25, "#79965a"); ground.addColorStop(1, "#6f8a4e");
    g.fillStyle = ground; g.fillRect(-W, HORIZON, 3 * W, 2 * H);
    const heading = Math.atan2(cam.s, cam.c);                          // hills that turn with the heading
    g.fillStyle = "#8ea3a0"; g.beginPath(); g.moveTo(-W, HORIZON + 1);
    for (let x = -W; x <= 2 * W; x += 12) {
      const a = heading - Math.atan((x - W / 2) / FOCAL);
      g.lineTo(x, HORIZON - 12 - 9 * Math.sin(3 * a) - 6 * Math.sin(7 * a + 1) - 3 * Math.sin(17 * a));
    }
    g.lineTo(2 * W, HORIZON + 1); g.fill();
    road(cam, k);
    const ahead = ({ columns: { x, y }, row }) => cam.c * (x[row] - cam.x) + cam.s * (y[row] - cam.y);
    const others = ghosts().filter(ghost => ghost.row >= 0 && ghost.columns.roll).sort((a, b) => ahead(b) - ahead(a));
    const here = ahead({ columns: ride, row: Math.round(k) });
    for (const ghost of others) if (ahead(ghost) >= here) machine(cam, ghost.columns, ghost.row, 0.45);
    machine(cam, ride, k);
    for (const ghost of others) if (ahead(ghost) < here) machine(cam, ghost.columns, ghost.row, 0.45);
    g.restore();
    const enlarged = Math.min(1.4, Math.max(1, 560 / (canvas.clientWidth || W)));   // to be read on a phone
    g.save(); g.scale(enlarged, enlarged); instruments(k); g.restore();
    g.save(); g.translate(W, 0); g.scale(enlarged, enlarged); g.translate(-W, 0); map(k); g.restore();
    g.restore();
  }
  return draw;
}

class FollowPart {
  constructor(view, figure, spec) {
    this.view = view;
    this.figure = figure;
    this.canvas = figure.querySelector("canvas");
    this.shape = [this.canvas.width, this.canvas.height];
    const others = () => view.shown().filter(series => series !== view.main && series.columns.x)
      .map(series => ({ columns: series.columns, row: view.rowIn(series, "time") }));
    this.drawing = followDrawing(this.canvas, () => view.main.columns, others, spec);
    new ResizeObserver(() => this.refit()).observe(this.canvas);
  }
  // Pixels that nobody sees are not painted: without a graphics processor they are most of what a frame takes.
  refit() {
    const { canvas, shape: [most, high] } = this, width = Math.min(most, Math.round(canvas.clientWidth * devicePixelRatio));
    if (width && width !== canvas.width) Object.assign(canvas, { width, height: Math.round(width * high / most) });
    this.view.redraw(part => part === this);
  }
  draw() { this.drawing(this.view.place); }
  point() { if (this.seen && this.view.moved) this.draw(); }
}
