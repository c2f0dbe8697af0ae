/**
 * Draws a running run: the points that its progress events carry are put at the end of the curves that are drawn.
 *
 * A curve that can grow says in its `meta.follow` which column of the course it shows and how that becomes its y:
 * `(value - origin) * factor`; `band` n is the outline of ±n sigma, a `level` only grows longer. Points are kept until the
 * figure that was fetched has them, so a figure may come later than its points.
 */
const KEPT = 600;
const COLUMNS = ["frame", "parameters", "sigma", "tail_rms_rad", "aggregate_rms_rad", "nis_per_dof"];
const none = () => ({ after: Infinity, ...Object.fromEntries(COLUMNS.map((name) => [name, []])) });
let course = none();

/** Forget all points: some were missed. */
export function forget() {
  course = none();
}

/** Keep the points of a progress event. */
export function keep(points) {
  if (!points) return;
  if (!course.frame.length || points.after !== course.frame.at(-1)) course = { ...none(), after: points.after ?? -Infinity };
  for (const name of COLUMNS) course[name].push(...(points[name] ?? points.frame.map(() => null)));
  const surplus = course.frame.length - KEPT;
  if (surplus > 0) course.after = course.frame[surplus - 1];
  if (surplus > 0) for (const name of COLUMNS) course[name].splice(0, surplus);
}

const valueOf = ({ column, index }, k) => (index === undefined ? course[column][k] : course[column][k]?.[index]) ?? null;

/** What a trace becomes with the points from the k-th on: only what changes. */
function grown({ x, y, customdata, meta }, first) {
  const { follow } = meta;
  const [xs, ys, frames] = [[...x], [...y], course.frame.slice(first)];
  if (follow.level) return { x: [xs[0], frames.at(-1)], y: ys };
  const scaled = (value) => (value === null ? null : (value - (follow.origin ?? 0)) * follow.factor);
  const values = frames.map((_, k) => scaled(valueOf(follow, first + k)));
  const reach = frames.map((_, k) => (valueOf({ ...follow, column: "sigma" }, first + k) ?? NaN) * follow.factor);
  if (!follow.band) return { x: [...xs, ...frames], y: [...ys, ...values], customdata: customdata && [...customdata, ...reach.map((one) => 3 * one)] };
  const half = xs.length / 2;
  const edge = (sign) => values.map((value, k) => value + sign * follow.band * reach[k]);
  const around = (all, up, down) => [...all.slice(0, half), ...up, ...down.toReversed(), ...all.slice(half)];
  return { x: around(xs, frames, frames), y: around(ys, edge(1), edge(-1)) };
}

/** Let an axis that showed the newest frame go on showing it; one that was zoomed stays. */
function stretched(layout, last) {
  const axes = Object.entries(layout).filter(([name, axis]) => /^xaxis\d*$/.test(name) && axis.range && !axis.autorange && axis.range[1] >= last);
  const newest = course.frame.at(-1);
  return Object.fromEntries(axes.map(([name, { range: [start] }]) => [`${name}.range`, [start, newest + 0.02 * (newest - start)]]));
}

/** Bring a drawn figure up to the newest point; false when points between are missing, null when it cannot be drawn on. */
export async function grow(figure) {
  const { canvas } = figure;
  const drawn = canvas?._fullLayout ? canvas._fullData : []; // its arrays are decoded
  const followed = drawn.flatMap(({ meta }, k) => (meta?.follow ? [k] : []));
  const curve = followed.find((k) => !drawn[k].meta.follow.level && !drawn[k].meta.follow.band);
  if (curve === undefined) return null;
  const last = drawn[curve].x.at(-1);
  if (!course.frame.length || course.after > last) return false;
  const first = course.frame.findIndex((frame) => frame > last);
  if (first < 0) return true;
  const traces = followed.map((k) => grown(drawn[k], first));
  const change = Object.fromEntries(["x", "y", "customdata"].map((name) => [name, traces.map((trace) => trace[name])]));
  await window.Plotly.update(canvas, change, stretched(canvas.layout, last), followed);
  return true;
}
