/**
 * One cursor for all charts of a page whose x axis counts the same: `layout.meta.axis` names the quantity. A line marks, in
 * every panel of every such chart, the place that the pointer is at in one of them; a chart whose axis ends before has none.
 */
import { findAll, make } from "./dom.js";
import { isDrawn, findPanels } from "./plotly.js";

/** @type {Map<Canvas, string | undefined>} */
const charts = new Map();

/**
 * Let a drawn chart tell of its pointer, and be told of the others'; again after each drawing, for the axis may change.
 * @param {Canvas} canvas
 * @param {string | undefined} axis
 */
export function linkCursor(canvas, axis) {
  const known = charts.has(canvas);
  charts.set(canvas, axis);
  if (known) return hide(canvas);
  canvas.addEventListener("pointermove", (event) => requestAnimationFrame(() => show(charts.get(canvas), findPosition(canvas, event))));
  canvas.addEventListener("pointerleave", () => requestAnimationFrame(hideAll));
  canvas.on?.("plotly_relayout", () => hide(canvas));
}

/** Forget a chart that leaves the page. @param {Canvas} canvas */
export const unlinkCursor = (canvas) => charts.delete(canvas);

/** Where on the axis of its panel a pointer is; nothing where it is over none. @param {Canvas} canvas @param {PointerEvent} event */
function findPosition(canvas, { clientX, clientY }) {
  const { left, top } = canvas.getBoundingClientRect();
  const [x, y] = [clientX - left, clientY - top];
  const panel = findPanels(canvas).find((one) => x >= one.left && x <= one.left + one.width && y >= one.top && y <= one.top + one.height);
  return panel?.valueAt(x);
}

/** @param {string | undefined} axis @param {number | undefined} x */
function show(axis, x) {
  if (!axis || typeof x !== "number") return hideAll();
  for (const [canvas, its] of charts) its === axis && isDrawn(canvas) ? mark(canvas, x) : hide(canvas);
}

function hideAll() {
  for (const canvas of charts.keys()) hide(canvas);
}

/** @param {Canvas} canvas */
function hide(canvas) {
  for (const line of lines(canvas)) line.hidden = true;
}

/** @param {Canvas} canvas */
const lines = (canvas) => findAll(":scope > .cursor-line", HTMLElement, canvas);

/** @param {Canvas} canvas @param {number} x */
function mark(canvas, x) {
  const panels = findPanels(canvas);
  while (lines(canvas).length < panels.length) canvas.append(make("div", { className: "cursor-line" }));
  for (const [place, line] of lines(canvas).entries()) {
    const panel = panels[place];
    const at = panel?.findPosition(x) ?? -1;
    line.hidden = !(panel && at >= 0 && at <= panel.width);
    if (panel && !line.hidden) Object.assign(line.style, { left: `${panel.left + at}px`, top: `${panel.top}px`, height: `${panel.height}px` });
  }
}
