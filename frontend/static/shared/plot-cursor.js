// One cursor for all charts of a page whose x axis counts the same: `layout.meta.axis` names the quantity. A line marks, in
// every panel of every such chart, the place that the pointer is at in one of them; a chart whose axis ends before has none.

const charts = new Map();

/** Let a drawn chart tell of its pointer, and be told of the others'; again after each drawing, for the axis may change. */
export function linkCursor(canvas, axis) {
  const known = charts.has(canvas);
  charts.set(canvas, axis);
  if (known) return hide(canvas);
  canvas.addEventListener("pointermove", (event) => requestAnimationFrame(() => show(charts.get(canvas), placeOf(canvas, event))));
  canvas.addEventListener("pointerleave", () => requestAnimationFrame(() => charts.forEach((_, one) => hide(one))));
  canvas.on("plotly_relayout", () => hide(canvas));
}

const panelsOf = (canvas) => Object.values(canvas._fullLayout?._plots ?? {}).filter(({ mainplot }) => !mainplot); // a second y axis lies over its first

/** Where on the axis of its panel a pointer is; nothing where it is over none. */
function placeOf(canvas, { clientX, clientY }) {
  const { left, top } = canvas.getBoundingClientRect();
  const [x, y] = [clientX - left, clientY - top];
  const isIn = (axis, at) => at >= axis._offset && at <= axis._offset + axis._length;
  const panel = panelsOf(canvas).find(({ xaxis, yaxis }) => isIn(xaxis, x) && isIn(yaxis, y));
  return panel?.xaxis.p2d(x - panel.xaxis._offset);
}

/** Forget a chart that leaves the page. */
export const unlinkCursor = (canvas) => charts.delete(canvas);

function show(axis, x) {
  if (!axis || typeof x !== "number") return charts.forEach((_, one) => hide(one));
  for (const [canvas, its] of charts) its === axis && canvas._fullLayout ? mark(canvas, x) : hide(canvas);
}

function hide(canvas) {
  for (const line of lines(canvas)) line.hidden = true;
}

const lines = (canvas) => canvas.querySelectorAll(":scope > .cursor-line");

function mark(canvas, x) {
  const panels = panelsOf(canvas);
  while (lines(canvas).length < panels.length) canvas.append(Object.assign(document.createElement("div"), { className: "cursor-line" }));
  for (const [place, line] of lines(canvas).entries()) {
    const { xaxis, yaxis } = panels[place] ?? {};
    const at = xaxis ? xaxis.d2p(x) : -1;
    line.hidden = !(at >= 0 && at <= xaxis._length);
    if (!line.hidden) Object.assign(line.style, { left: `${xaxis._offset + at}px`, top: `${yaxis._offset}px`, height: `${yaxis._length}px` });
  }
}
