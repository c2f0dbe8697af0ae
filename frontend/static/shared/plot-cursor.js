/**
 * One cursor for all charts of a page whose x axis counts the same: `layout.meta.axis` names the quantity. A line marks, in
 * every panel of every such chart, the place that the pointer is at in one of them; a chart whose axis ends before has none.
 * A click sets it: it then stands there, and in the address, while no pointer is over a chart. Escape, a click on it or a double click takes it away.
 */
import { findAll, make } from "./dom.js";
import { isDrawn, findPanels } from "./plotly.js";
import { getCursor, keepCursor } from "./view-address.js";

const SAME_PX = 6;

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
  rest(canvas);
  if (known) return;
  canvas.addEventListener("pointermove", (event) => requestAnimationFrame(() => show(charts.get(canvas), findPosition(canvas, event))));
  canvas.addEventListener("pointerleave", () => requestAnimationFrame(restAll));
  canvas.addEventListener("click", (event) => set(canvas, event));
  canvas.on?.("plotly_relayout", () => rest(canvas));
  canvas.on?.("plotly_doubleclick", forget);
}

/** Forget a chart that leaves the page. @param {Canvas} canvas */
export const unlinkCursor = (canvas) => charts.delete(canvas);

/** Where on the axis of its panel a pointer is; nothing where it is over none. @param {Canvas} canvas @param {MouseEvent} event */
function findPosition(canvas, { clientX, clientY }) {
  const { left, top } = canvas.getBoundingClientRect();
  const [x, y] = [clientX - left, clientY - top];
  const panel = findPanels(canvas).find((one) => x >= one.left && x <= one.left + one.width && y >= one.top && y <= one.top + one.height);
  return panel?.valueAt(x);
}

/** @param {string | undefined} axis @param {number | undefined} x */
function show(axis, x) {
  if (!axis || typeof x !== "number") return restAll();
  for (const [canvas, its] of charts) its === axis && isDrawn(canvas) ? mark(canvas, x) : hide(canvas);
}

/** Set the cursor where a chart was clicked, or take it away where it stood. @param {Canvas} canvas @param {MouseEvent} event */
function set(canvas, event) {
  const [axis, x, was] = [charts.get(canvas), findPosition(canvas, event), getCursor()];
  if (!axis || typeof x !== "number" || event.detail > 1) return;
  const panel = findPanels(canvas)[0];
  const isSame = was?.axis === axis && panel && Math.abs(panel.findPosition(was.x) - panel.findPosition(x)) < SAME_PX;
  if (isSame) keepCursor();
  else keepCursor(axis, x);
  restAll();
}

function forget() {
  if (!getCursor()) return;
  keepCursor();
  restAll();
}

/** Show the cursor that was set, or none. @param {Canvas} canvas */
function rest(canvas) {
  const cursor = getCursor();
  if (cursor && cursor.axis === charts.get(canvas) && isDrawn(canvas)) mark(canvas, cursor.x);
  else hide(canvas);
}

function restAll() {
  for (const canvas of charts.keys()) rest(canvas);
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

addEventListener("hashchange", restAll);
document.addEventListener("keydown", ({ key }) => key === "Escape" && forget());
