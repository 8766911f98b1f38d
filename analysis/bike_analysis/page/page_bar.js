// What stands beside the drawings: axis, zoom, playing, series, and what is told about the cursor.

function buildBar(view) {
  const bar = view.root;
  const on = (name, action) => { bar.querySelector(`[data-do="${name}"]`).onclick = action; };
  for (const choice of bar.querySelectorAll("input[type=radio]")) choice.onchange = () => view.setAxis(choice.value);
  on("in", () => view.zoom(1 / ZOOM));
  on("out", () => view.zoom(ZOOM));
  on("whole", () => view.setRange(...view.whole()));
  on("play", () => play(view));
  const list = view.root.querySelector(".series"), reference = view.root.querySelector("select.reference");
  if (list && view.several) list.replaceChildren(...view.series.map(series => seriesButton(view, series)));
  if (reference) reference.onchange = () => { view.compareWith(view.series[reference.value]); view.moved = true; view.redraw(); };
  for (const part of view.parts) if (part.plot) makeSlider(view, part);
}

function seriesButton(view, series) {
  const button = element("button", { type: "button" }, swatch({ series, colour: series.colour }), series.name);
  button.setAttribute("aria-pressed", "true");
  button.disabled = series === view.main;
  button.onclick = () => {
    series.hidden = !series.hidden;
    button.setAttribute("aria-pressed", String(!series.hidden));
    view.redraw();
  };
  const raise = one => () => { view.raised = one; view.redraw(part => part instanceof PanelPart); };
  for (const kind of ["pointerenter", "focus"]) button.addEventListener(kind, raise(series));
  for (const kind of ["pointerleave", "blur"]) button.addEventListener(kind, raise(null));
  return button;
}

// Each drawing is a slider for assistive technology: its value is where the cursor stands.
function makeSlider(view, part) {
  const title = part.figure.querySelector("h4").textContent;
  Object.entries({ role: "slider", "aria-label": `${title}: cursor along the ride`, "aria-orientation": "horizontal" })
    .forEach(([name, value]) => part.plot.setAttribute(name, value));
  part.plot.tabIndex = 0;
  part.plot.addEventListener("keydown", event => { if (steer(view, event, true)) event.preventDefault(); });
}

// Keys; those that scroll the page only count where a drawing has the focus.
function steer(view, event, focused) {
  if (event.altKey || event.ctrlKey || event.metaKey) return false;
  const axis = view.main.columns[view.axis], [low, high] = view.range;
  const rows = Math.max(rowOf(axis, high) - rowOf(axis, low), 1), last = axis.length - 1;
  const step = Math.max(1, Math.round(rows / (event.shiftKey ? 20 : 200)));
  const keys = {
    ArrowRight: () => view.setPlace(view.row + step), ArrowLeft: () => view.setPlace(view.row - step),
    "+": () => view.zoom(1 / ZOOM), "=": () => view.zoom(1 / ZOOM), "-": () => view.zoom(ZOOM),
    "0": () => view.setRange(...view.whole()), p: () => play(view),
  };
  const more = {
    ArrowUp: keys.ArrowRight, ArrowDown: keys.ArrowLeft, Home: () => view.setPlace(0), End: () => view.setPlace(last),
    PageUp: () => view.setPlace(view.row + rows / 10), PageDown: () => view.setPlace(view.row - rows / 10), " ": keys.p,
  };
  const action = keys[event.key] || (focused && more[event.key]);
  if (!action) return false;
  action();
  return true;
}

function tell(view) {
  const { distance, time } = view.main.columns, row = view.row;
  const section = view.sections.find(s => row >= s.first && row < s.last), length = time.length;
  const where = `${numberText(distance[row], 1)}\u202fm`, when = clockText(time[row]);
  const words = [where, when, section ? section.name : ""];
  view.root.querySelectorAll(".now span").forEach((span, k) => write(span, words[k]));
  for (const part of view.parts) {
    if (!part.plot || !part.seen) continue;
    part.plot.setAttribute("aria-valuemin", "0");
    part.plot.setAttribute("aria-valuemax", String(length - 1));
    part.plot.setAttribute("aria-valuenow", String(row));
    part.plot.setAttribute("aria-valuetext", [where, when, part.said].filter(Boolean).join(", "));
  }
}

// Moves the cursor at the ride's own pace, until the end or another call.
function play(view) {
  const button = view.root.querySelector('[data-do="play"]'), rate = view.root.querySelector("select.rate");
  view.playing = !view.playing;
  button.textContent = view.playing ? "Pause" : "Play";
  if (!view.playing) return;
  const { time } = view.main.columns, last = time.length - 1;
  if (view.place >= last) view.place = 0;
  let before = null, now = timeAt(time, view.place);
  const tick = stamp => {
    if (!view.playing) return;
    if (before !== null) now += (stamp - before) / 1000 * parseFloat(rate.value);
    before = stamp;
    const row = Math.max(rowOf(time, now), 1);
    if (row > last) { view.setPlace(last); play(view); return; }
    view.setPlace(row - 1 + (now - time[row - 1]) / (time[row] - time[row - 1] || 1));
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}
const timeAt = (time, place) => {
  const row = Math.min(Math.floor(place), time.length - 2);
  return row < 0 ? time[0] : time[row] + (place - row) * (time[row + 1] - time[row]);
};
