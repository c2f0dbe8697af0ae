/**
 * A zoomed figure gets the points that were thinned away: the window is asked for with x_from and x_to, and the curves of
 * the panels that show it are replaced. Figures say by `layout.meta.detail` that there is more than what is drawn.
 */
import { fetchJson } from "./problem.js";

const WAIT_MS = 250;
const waiting = new WeakMap();

const axisOf = (trace) => (trace.xaxis ?? "x").replace("x", "xaxis");
const shows = (range, [from, to]) => Math.abs(range[0] - from) + Math.abs(range[1] - to) < 1e-6 * Math.abs(to - from);

/** The window that a change of the axes zoomed to; null where it shows all again, undefined where no x axis moved. */
function windowOf(change) {
  const key = Object.keys(change).find((name) => /^xaxis\d*\.(range\[0\]|autorange)$/.test(name));
  if (!key) return undefined;
  const axis = key.split(".")[0];
  return change[`${axis}.autorange`] ? null : [change[`${axis}.range[0]`], change[`${axis}.range[1]`]];
}

async function detail(element, range) {
  const window_ = range ? `x_from=${range[0]}&x_to=${range[1]}` : "";
  const address = element.getAttribute("src");
  const fresh = await fetchJson(`${address}${address.includes("?") ? "&" : "?"}${window_}`);
  const { canvas } = element;
  const layout = canvas._fullLayout;
  const data = canvas.data.map((trace, i) => (!range || shows(layout[axisOf(trace)].range, range) ? (fresh.data[i] ?? trace) : trace));
  await window.Plotly.react(canvas, data, canvas.layout);
}

document.addEventListener("figure-drawn", ({ target }) => {
  if (!target.canvas?.layout?.meta?.detail || waiting.has(target)) return;
  waiting.set(target, 0);
  target.canvas.on("plotly_relayout", (change) => {
    const range = windowOf(change);
    if (range === undefined) return;
    clearTimeout(waiting.get(target));
    waiting.set(target, setTimeout(() => detail(target, range).catch(() => {}), WAIT_MS)); // without detail the drawing stays
  });
});
