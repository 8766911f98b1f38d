// Starts the page: views when they come near the screen, theme, keys and print.

const views = [];
const root = document.documentElement;
const darkAsked = matchMedia("(prefers-color-scheme: dark)");
const isDark = () => (root.dataset.theme || (darkAsked.matches ? "dark" : "light")) === "dark";
const THEME_KEY = "two-wheeler-lab-theme";

function recolour() {
  const button = document.getElementById("theme");
  colours.clear();
  button.setAttribute("aria-pressed", String(isDark()));
  button.textContent = isDark() ? "Light" : "Dark";
  for (const view of views) view.redraw();
}
function toggleTheme() {
  root.dataset.theme = isDark() ? "light" : "dark";
  try { localStorage.setItem(THEME_KEY, root.dataset.theme); } catch { /* a page may not be allowed to remember */ }
  recolour();
}
try { const kept = localStorage.getItem(THEME_KEY); if (kept) root.dataset.theme = kept; } catch { /* as above */ }

// The view that keys without a focus go to: the one in which something has been done, else the first on the screen.
function present() {
  const onScreen = views.filter(view => {
    const box = view.root.getBoundingClientRect();
    return view.series && box.bottom > 0 && box.top < innerHeight;
  });
  return onScreen.find(view => view === present.last) || onScreen[0];
}

document.addEventListener("keydown", event => {
  if (event.defaultPrevented || event.target.closest("input, select, textarea, button, summary, a")) return;
  if (event.key === "t" && !event.ctrlKey && !event.metaKey && !event.altKey) { toggleTheme(); return; }
  const view = present();
  if (view && steer(view, event, false)) event.preventDefault();
});
document.getElementById("theme").onclick = toggleTheme;
darkAsked.addEventListener("change", recolour);

// Printed in the light colours and as wide as paper.
function prepareForPrint(begin) {
  root.classList.toggle("printing", begin);
  colours.clear();
  for (const view of views) if (view.series) {
    for (const part of view.parts) part.draw();
    view.moved = true;
    view.frame();
  }
}
addEventListener("beforeprint", () => prepareForPrint(true));
addEventListener("afterprint", () => prepareForPrint(false));

const specs = JSON.parse(document.getElementById("page-data").textContent);
const near = new IntersectionObserver(entries => {
  for (const entry of entries) if (entry.isIntersecting) { near.unobserve(entry.target); entry.target.view.open(); }
}, { rootMargin: "600px" });
document.querySelectorAll(".view").forEach((section, k) => {
  const view = new View(section, specs[k]);
  section.view = view;
  views.push(view);
  section.addEventListener("pointerdown", () => { present.last = view; });
  section.addEventListener("focusin", () => { present.last = view; });
  near.observe(section);
});
recolour();

// Where there is not too much of it, the rest is drawn in idle time, so that all is there when the page is printed.
const rowsInAll = specs.flatMap(spec => spec.series).reduce((sum, series) => sum + series.columns.time.rows, 0);
const openFrom = k => setTimeout(() => views[k]?.open().then(() => openFrom(k + 1)), 300);
if (rowsInAll < 200000) openFrom(0);
