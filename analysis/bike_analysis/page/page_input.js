// Pointers on a drawing: mouse, pen and fingers told as hover, pan, zoom, select and reset.
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
