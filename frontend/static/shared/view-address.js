/**
 * How the charts of a page are looked at, in the fragment of its address, so that a copied link opens the same view:
 * `#zoom.NAME=x_FROM_TO,y2_FROM_TO&at=QUANTITY_X`, the zoomed axes of each chart by its name, and the cursor that was set.
 */

const ZOOM = "zoom.";
const CURSOR = "at";
const LONGEST = 1500;
const RANGE = /^([xy])(\d*)_(-?[\d.e+: -]+)_(-?[\d.e+: -]+)$/;
const CHANGED = /^([xy]axis\d*)\.(range\[0\]|range|autorange)$/; // a double click says `range` for all that there is
/** @typedef {Map<AxisName, [number | string, number | string]>} Zoom */

/** What the fragment says; one that names a place of the page says nothing of charts. */
const read = () => new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");

/** @param {URLSearchParams} said */
function write(said) {
  const text = said.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
  if (text.length > LONGEST) return;
  history.replaceState(history.state, "", text ? `#${text}` : location.pathname + location.search);
}

/** A number, or a date as Plotly writes it. @param {string} text */
const value = (text) => (Number.isFinite(Number(text)) ? Number(text) : text);

/** The axes of a chart that are zoomed. @param {string} name @returns {Zoom} */
export function getZoom(name) {
  /** @type {Zoom} */
  const zoom = new Map();
  for (const part of (read().get(ZOOM + name) ?? "").split(",")) {
    const [, letter, number = "", from, to] = RANGE.exec(part) ?? [];
    if (letter && from && to) zoom.set(letter === "x" ? `xaxis${number}` : `yaxis${number}`, [value(from), value(to)]);
  }
  return zoom;
}

/** Keep what was changed of the axes of a chart. @param {string} name @param {ZoomChange} change */
export function keepZoom(name, change) {
  const zoom = getZoom(name);
  const axes = Object.keys(change).map((key) => /** @type {AxisName | undefined} */ (CHANGED.exec(key)?.[1])).filter((axis) => axis !== undefined);
  if (!axes.length) return;
  for (const axis of axes) {
    const [from, to] = [change[`${axis}.range[0]`], change[`${axis}.range[1]`]];
    if (isEnd(from) && isEnd(to)) zoom.set(axis, [from, to]);
    else zoom.delete(axis);
  }
  const said = read();
  const parts = [...zoom].map(([axis, ends]) => [axis.replace("axis", ""), ...ends.map(short)].join("_"));
  if (parts.length) said.set(ZOOM + name, parts.join(","));
  else said.delete(ZOOM + name);
  write(said);
}

/** @param {ZoomChange[string]} end @returns {end is number | string} */
const isEnd = (end) => typeof end === "number" || typeof end === "string";

/** Seven digits say more than a screen shows. @param {number | string} end */
const short = (end) => (typeof end === "number" ? String(Number(end.toPrecision(7))) : end);

/** The cursor that was set: the quantity of its axis, and where on it. @returns {{ axis: string, x: number } | null} */
export function getCursor() {
  const [, axis, text] = /^(\w+)_(-?[\d.e+-]+)$/.exec(read().get(CURSOR) ?? "") ?? [];
  const x = Number(text);
  return axis && Number.isFinite(x) ? { axis, x } : null;
}

/** Keep the cursor, or take it away. @param {string} [axis] @param {number} [x] */
export function keepCursor(axis, x) {
  const said = read();
  if (axis && x !== undefined) said.set(CURSOR, `${axis}_${short(x)}`);
  else said.delete(CURSOR);
  write(said);
}
