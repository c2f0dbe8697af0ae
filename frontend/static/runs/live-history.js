/**
 * Draws a running run: the points that its progress events carry are put at the end of the curves that are drawn.
 *
 * A curve that can grow says in its `meta.follow` which column of the history it shows and how that becomes its y:
 * `(value - origin) * factor`; `band` n is the outline of ±n sigma, `share` its sigma over the value, a `level` only grows
 * longer. Points are kept until the figure that was fetched has them, so a figure may come later than its points.
 */
import { change, getTraces } from "../shared/plotly.js";

const KEPT = 600;
const COLUMNS = /** @type {const} */ (["parameters", "sigma", "tail_rms_rad", "aggregate_rms_rad", "nis_per_dof"]);

/** The frames of the points that are kept, their values by column, and the frame before the first. */
class History {
  /** @type {number[]} */
  frame = [];
  /** @type {Record<typeof COLUMNS[number], (number | null | (number | null)[])[]>} */
  columns = { parameters: [], sigma: [], tail_rms_rad: [], aggregate_rms_rad: [], nis_per_dof: [] };

  at = "";

  /** @param {number} after */
  constructor(after) {
    this.after = after;
  }

  /** @param {HistoryPoints} points */
  add(points) {
    this.frame.push(...points.frame);
    this.at = new Date().toISOString();
    for (const name of COLUMNS) this.columns[name].push(...(points[name] ?? points.frame.map(() => null)));
    const surplus = this.frame.length - KEPT;
    if (surplus <= 0) return;
    this.after = this.frame[surplus - 1] ?? this.after;
    for (const values of [this.frame, ...Object.values(this.columns)]) values.splice(0, surplus);
  }

  /** The value of a curve at the k-th point. @param {Follow} follow @param {number} k */
  value({ column, index }, k) {
    const value = this.columns[column][k] ?? null;
    return Array.isArray(value) ? (index === undefined ? null : value[index] ?? null) : value;
  }
}

let history = new History(Infinity);

/** Forget all points: some were missed. */
export function forget() {
  history = new History(Infinity);
}

/** Keep the points of a progress event. @param {HistoryPoints | undefined} points */
export function keep(points) {
  if (!points) return;
  if (!history.frame.length || points.after !== history.frame.at(-1)) history = new History(points.after ?? -Infinity);
  history.add(points);
}

/**
 * What a trace becomes with the points from the k-th on: only what changes.
 * @param {DrawnTrace} trace
 * @param {Follow} follow
 * @param {number} first
 * @returns {{ x: (number | undefined)[], y: (number | null)[], customdata?: number[] | undefined }}
 */
function grown({ x, y, customdata }, follow, first) {
  const [xs, ys, frames] = [[...x], [...y], history.frame.slice(first)];
  if (follow.level) return { x: [xs[0], frames.at(-1)], y: ys };
  /** @param {number | null} value */
  const scaled = (value) => (value === null ? null : (value - (follow.origin ?? 0)) * follow.factor);
  const values = frames.map((_, k) => scaled(history.value(follow, first + k)));
  const sigma = frames.map((_, k) => (follow.share ? follow.share * (history.value(follow, first + k) ?? NaN) : history.value({ ...follow, column: "sigma" }, first + k) ?? NaN));
  const reach = sigma.map((one) => one * follow.factor);
  if (!follow.band) return { x: [...xs, ...frames], y: [...ys, ...values], customdata: customdata && [...customdata, ...reach.map((one) => 3 * one)] };
  const half = xs.length / 2;
  /** @param {1 | -1} sign */
  const edge = (sign) => values.map((value, k) => (value ?? 0) + sign * (follow.band ?? 0) * (reach[k] ?? NaN));
  /** @type {<T>(all: T[], up: T[], down: T[]) => T[]} */
  const around = (all, up, down) => [...all.slice(0, half), ...up, ...down.toReversed(), ...all.slice(half)];
  return { x: around(xs, frames, frames), y: around(ys, edge(1), edge(-1)) };
}

/** Let an axis that showed the newest frame go on showing it; one that was zoomed stays. @param {Layout} layout @param {number} last */
function stretched(layout, last) {
  const newest = history.frame.at(-1) ?? last;
  /** @type {Record<string, [number, number]>} */
  const ranges = {};
  for (const [name, axis] of Object.entries(layout)) {
    if (!/^xaxis\d*$/.test(name) || !axis.range || axis.autorange || axis.range[1] < last) continue;
    const [start] = axis.range;
    ranges[`${name}.range`] = [start, newest + 0.02 * (newest - start)];
  }
  return ranges;
}

/** The frame of the newest point that is kept, and when it came. */
export function getNewest() {
  const frame = history.frame.at(-1);
  return frame === undefined ? null : { frame, at: history.at };
}

/**
 * Bring a drawn figure up to the newest point; false when points between are missing, null when it cannot be drawn on.
 * @param {Canvas} canvas
 */
export async function grow(canvas) {
  const followed = getTraces(canvas).flatMap((trace, place) => (trace.meta?.follow ? [{ trace, place, follow: trace.meta.follow }] : []));
  const curve = followed.find(({ follow }) => !follow.level && !follow.band);
  const last = curve && Array.from(curve.trace.x).at(-1);
  if (last === undefined || !canvas.layout) return null;
  if (!history.frame.length || history.after > last) return false;
  const first = history.frame.findIndex((frame) => frame > last);
  if (first < 0) return true;
  const traces = followed.map(({ trace, follow }) => grown(trace, follow, first));
  const values = { x: traces.map(({ x }) => x), y: traces.map(({ y }) => y), customdata: traces.map(({ customdata }) => customdata) };
  await change(canvas, values, stretched(canvas.layout, last), followed.map(({ place }) => place));
  return true;
}
