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
  function project(cam, x, y, z) {
    const dx = x - cam.x, dy = y - cam.y;
    const ahead = cam.c * dx + cam.s * dy, left = -cam.s * dx + cam.c * dy;
    if (ahead < NEAR) return null;
    return [W / 2 - FOCAL * left / ahead, HORIZON + FOCAL * (UP - z) / ahead, ahead];
  }
  function toCamera(cam, x, y) {
    const dx = x - cam.x, dy = y - cam.y;
    return [cam.c * dx + cam.s * dy, -cam.s * dx + cam.c * dy];
  }
  // A strip between two polylines, cut at the near plane; all of one colour is one path, which is filled much sooner than many.
  function strip(cam, ax, ay, bx, by, first, last, colour) {
    const corners = new Map();
    if (open) { first = Math.max(first, 0); last = Math.min(last, E - 1); }
    for (let k = last - 1; k >= first; k--) {
      const i = ((k % E) + E) % E, j = (i + 1) % E;
      let quad = [[ax[i], ay[i]], [ax[j], ay[j]], [bx[j], by[j]], [bx[i], by[i]]].map(p => toCamera(cam, p[0], p[1]));
      const cut = [];
      for (let q = 0; q < 4; q++) {
        const p = quad[q], n = quad[(q + 1) % 4];
        if (p[0] >= NEAR) cut.push(p);
        if ((p[0] >= NEAR) !== (n[0] >= NEAR)) {
          const u = (NEAR - p[0]) / (n[0] - p[0]);
          cut.push([NEAR, mix(p[1], n[1], u)]);
        }
      }
      if (cut.length < 3) continue;
      const ink = typeof colour === "function" ? colour(k) : colour;
      if (!corners.has(ink)) corners.set(ink, []);
      corners.get(ink).push(cut);
    }
    for (const [ink, quads] of corners) {
      g.fillStyle = ink;
      g.beginPath();
      for (const cut of quads) {
        cut.forEach((p, q) => {
          const X = W / 2 - FOCAL * p[1] / p[0], Y = HORIZON + FOCAL * UP / p[0];
          q ? g.lineTo(X, Y) : g.moveTo(X, Y);
        });
        g.closePath();
      }
      g.fill();
    }
  }
  function beside(u) {           // a polyline between the limits: 0 left, 1 right
    return [lx.map((v, i) => mix(v, rx[i], u)), ly.map((v, i) => mix(v, ry[i], u))];
  }
  const width = lx.map((v, i) => Math.hypot(v - rx[i], ly[i] - ry[i]));
  const mean = width.reduce((a, b) => a + b, 0) / E;
  const kerbL = beside(-0.9 / mean), kerbR = beside(1 + 0.9 / mean), grassL = beside(-14 / mean),
    grassR = beside(1 + 14 / mean), whiteL = beside(0.16 / mean), whiteR = beside(1 - 0.16 / mean);
  const bend = lx.map((_, i) => {
    const p = (i - 3 + E) % E, n = (i + 3) % E;
    const a = Math.atan2(ly[i] - ly[p], lx[i] - lx[p]), b = Math.atan2(ly[n] - ly[i], lx[n] - lx[i]);
    return Math.abs(Math.atan2(Math.sin(b - a), Math.cos(b - a)));
  });

  function road(cam, k) {
    const s = Math.floor(at(ride.distance, Math.floor(k)) / step);
    const first = s - 4, last = s + Math.floor(FAR / step);
    const kerb = q => kind === "superbike" && bend[((q % E) + E) % E] > 0.04 ? (q % 2 ? "#d8412f" : "#f3f3f3") : "#6f8a4e";
    strip(cam, grassL[0], grassL[1], lx, ly, first, last, q => q % 4 < 2 ? "#5f7f45" : "#66884b");
    strip(cam, grassR[0], grassR[1], rx, ry, first, last, q => q % 4 < 2 ? "#5f7f45" : "#66884b");
    strip(cam, lx, ly, rx, ry, first, last, q => q % 6 < 3 ? "#4a4e55" : "#4d5158");
    strip(cam, kerbL[0], kerbL[1], lx, ly, first, last, kerb);
    strip(cam, kerbR[0], kerbR[1], rx, ry, first, last, kerb);
    strip(cam, lx, ly, whiteL[0], whiteL[1], first, last, "#e8e8e8");
    strip(cam, rx, ry, whiteR[0], whiteR[1], first, last, "#e8e8e8");
    if (!line.length) return;
    g.strokeStyle = "rgba(120,200,255,.55)"; g.lineWidth = 2; g.beginPath();
    let pen = false;
    for (let q = s + 1; q < (open ? Math.min(last, E) : last); q++) {
      const i = ((q % E) + E) % E, p = project(cam, line[0][i], line[1][i], 0);
      if (!p) { pen = false; continue; }
      pen ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1]); pen = true;
    }
    g.stroke();
  }

  // Machine and rider from behind, in metres: u to the right, v up, about the contact point.
  function machine(cam, rider, k, alpha = 1) {
    const p = project(cam, at(rider.x, k), at(rider.y, k), 0);
    if (!p || p[2] > FAR) return;
    const m = FOCAL / p[2], roll = at(rider.roll, k) * Math.PI / 180, hang = Math.max(-1, Math.min(1, roll / 0.87));
    g.save();
    g.globalAlpha = alpha;
    g.translate(p[0], p[1]);
    g.fillStyle = "rgba(0,0,0,.35)";
    g.beginPath(); g.ellipse(0.3 * m * Math.sin(roll), 0, (0.3 + 0.5 * Math.abs(Math.sin(roll))) * m, 0.07 * m, 0, 0, 7);
    g.fill();
    g.rotate(roll);
    const shape = (colour, points) => {
      g.fillStyle = colour; g.beginPath();
      points.forEach(([u, v], i) => i ? g.lineTo(u * m, -v * m) : g.moveTo(u * m, -v * m));
      g.closePath(); g.fill();
    };
    const disc = (colour, u, v, a, b) => {
      g.fillStyle = colour; g.beginPath(); g.ellipse(u * m, -v * m, a * m, b * m, 0, 0, 7); g.fill();
    };
    if (kind === "bicycle") { bicycle(m, shape, disc, (rider.steer ? at(rider.steer, k) : 0) * Math.PI / 180); g.restore(); return; }
    disc("#15171a", 0, 0.32, 0.10, 0.32);                                              // rear tyre
    disc("#2b2e33", 0, 0.32, 0.05, 0.22);
    shape("#8f1a12", [[-0.15, 0.42], [0.15, 0.42], [0.25, 0.75], [0.21, 0.98], [-0.21, 0.98], [-0.25, 0.75]]); // fairing
    shape("#c8261a", [[-0.11, 0.55], [0.11, 0.55], [0.14, 0.92], [-0.14, 0.92]]);      // tail
    shape("#ffce45", [[-0.06, 0.78], [0.06, 0.78], [0.05, 0.84], [-0.05, 0.84]]);      // number
    g.strokeStyle = "#22252a"; g.lineWidth = 0.05 * m; g.beginPath();
    g.moveTo(-0.33 * m, -0.93 * m); g.lineTo(0.33 * m, -0.93 * m); g.stroke();         // bars
    const q = 0.2 * hang, knee = 0.30;
    shape("#1f4f8f", [[-0.17 + q, 0.80], [0.17 + q, 0.80], [0.25 + 1.3 * q, 1.22], [0.12 + 1.6 * q, 1.36],
      [-0.12 + 1.6 * q, 1.36], [-0.25 + 1.3 * q, 1.22]]);                              // back
    shape("#173a69", [[-0.12 + q, 0.84], [-0.24 + q - Math.max(0, -hang) * knee, 0.60 - 0.1 * Math.max(0, -hang)],
      [-0.17, 0.42], [-0.10, 0.66]]);                                                  // left leg
    shape("#173a69", [[0.12 + q, 0.84], [0.24 + q + Math.max(0, hang) * knee, 0.60 - 0.1 * Math.max(0, hang)],
      [0.17, 0.42], [0.10, 0.66]]);                                                    // right leg
    g.strokeStyle = "#1f4f8f"; g.lineWidth = 0.09 * m; g.lineCap = "round";
    for (const side of [-1, 1]) {
      g.beginPath(); g.moveTo((0.22 * side + 1.3 * q) * m, -1.18 * m);
      g.lineTo((0.37 * side + 0.5 * q) * m, -1.04 * m); g.lineTo(0.31 * side * m, -0.94 * m); g.stroke();
    }
    disc("#e9ebee", 1.9 * q, 1.45, 0.135, 0.15);                                       // helmet
    disc("#c8261a", 1.9 * q, 1.49, 0.05, 0.11);
    g.restore();
  }

  // A bicycle and its rider, who sits still.
  function bicycle(m, shape, disc, steer) {
    disc("#15171a", 0, 0.3, 0.025, 0.3);                                               // rear tyre
    g.strokeStyle = "#22252a"; g.lineWidth = 0.035 * m; g.beginPath();
    g.moveTo(-0.28 * m * Math.cos(steer), -0.98 * m); g.lineTo(0.28 * m * Math.cos(steer), -0.98 * m); g.stroke();  // bars
    shape("#0b66ad", [[-0.02, 0.3], [0.02, 0.3], [0.02, 0.85], [-0.02, 0.85]]);        // frame
    shape("#22252a", [[-0.1, 0.85], [0.1, 0.85], [0.06, 0.91], [-0.06, 0.91]]);        // saddle
    g.strokeStyle = "#39424d"; g.lineWidth = 0.11 * m; g.lineCap = "round";
    for (const side of [-1, 1]) { g.beginPath(); g.moveTo(0.08 * side * m, -0.9 * m); g.lineTo(0.13 * side * m, -0.3 * m); g.stroke(); }
    shape("#1f8f6b", [[-0.14, 0.88], [0.14, 0.88], [0.21, 1.38], [-0.21, 1.38]]);      // back
    g.strokeStyle = "#1f8f6b"; g.lineWidth = 0.08 * m;
    for (const side of [-1, 1]) { g.beginPath(); g.moveTo(0.2 * side * m, -1.32 * m); g.lineTo(0.27 * side * m, -1.0 * m); g.stroke(); }
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
