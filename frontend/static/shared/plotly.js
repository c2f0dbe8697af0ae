/**
 * The drawing library, and what it keeps to itself: only this module touches Plotly or knows its private fields.
 */
import { make } from "./dom.js";
import { writeNumbersIn } from "./numbers.js";

const FILE = new URL("../plotly.min.js", import.meta.url).href; // of the same version
// Plotly writes its maps' style sheet into the page unless this is there; no figure is a map, and the policy refuses it
const MAP_STYLE = "9f215cf04c5486422605d13261cb87401f4e7763b6296af81e98efbc0130da53";
const CONFIG = { displaylogo: false, displayModeBar: false, responsive: false, scrollZoom: false };
const IMAGE = { width: 1200, scale: 2 };

/**
 * What Plotly keeps at an element that it has drawn in.
 * @typedef {Axis & { range: [number, number], _offset: number, _length: number, p2d: (px: number) => number, d2p: (value: number) => number }} InnerAxis
 * @typedef {{ xaxis: InnerAxis, yaxis: InnerAxis, mainplot?: string }} InnerPlot
 * @typedef {{ numberFormat: (form: string) => (value: number) => string }} Locale
 * @typedef {{ width: number, height: number, _plots?: Record<string, InnerPlot>, _d3locale?: Locale } & { [axis: AxisName]: InnerAxis }} InnerLayout
 * @typedef {Canvas & { _fullLayout?: InnerLayout, _fullData?: DrawnTrace[] }} Inner
 */

/** @type {(canvas: Canvas) => Inner} */
const inner = (canvas) => canvas;

/** @type {Promise<PlotlyLibrary> | null} */
let loading = null;

/** Load Plotly once for the whole page, when the first figure needs it. */
export function load() {
  loading ??= new Promise((resolve, reject) => {
    const fail = () => {
      loading = null;
      script.remove();
      reject(new Error("The drawing library did not load. Check the connection, then press Retry."));
    };
    const script = make("script", { src: FILE, async: true, onerror: fail, onload: () => (window.Plotly ? resolve(window.Plotly) : fail()) });
    document.head.append(make("meta", { id: MAP_STYLE }), script);
  });
  return loading;
}

/** Whether a figure stands in an element. @param {Canvas} canvas */
export const isDrawn = (canvas) => Boolean(inner(canvas)._fullLayout);

/** The traces that are drawn, their arrays decoded. @param {Canvas} canvas */
export const getTraces = (canvas) => (isDrawn(canvas) ? inner(canvas)._fullData ?? [] : []);

/** What an x axis shows. @param {Canvas} canvas @param {AxisName} axis */
export const getRange = (canvas, axis) => inner(canvas)._fullLayout?.[axis]?.range;

/** The panels of a drawn figure, in pixels of its element; a second y axis lies over its first. @param {Canvas} canvas */
export function findPanels(canvas) {
  const plots = Object.values(inner(canvas)._fullLayout?._plots ?? {}).filter(({ mainplot }) => !mainplot);
  return plots.map(({ xaxis, yaxis }) => ({
    left: xaxis._offset,
    top: yaxis._offset,
    width: xaxis._length,
    height: yaxis._length,
    /** @param {number} px */
    valueAt: (px) => xaxis.p2d(px - xaxis._offset),
    /** @param {number} x */
    findPosition: (x) => xaxis.d2p(x),
  }));
}

/** Draw a figure, or what has changed of it. @param {Canvas} canvas @param {Figure} figure */
export async function draw(canvas, { data, layout }) {
  const isFirst = !isDrawn(canvas);
  await (await load()).react(canvas, data, layout, CONFIG);
  if (isFirst) canvas.on?.("plotly_beforehover", () => writeNumbersIn(inner(canvas)._fullLayout?._d3locale));
}

/**
 * Give some traces other values, and the layout other properties.
 * @param {Canvas} canvas
 * @param {Record<string, unknown[]>} traces
 * @param {Record<string, unknown>} layout
 * @param {number[]} which
 */
export const change = async (canvas, traces, layout, which) => void (await (await load()).update(canvas, traces, layout, which));

/**
 * Have axes of a drawn figure show a part of them, and all others everything; axes that it has not are left alone.
 * @param {Canvas} canvas
 * @param {Map<AxisName, [number | string, number | string]>} zoom
 */
export async function zoomTo(canvas, zoom) {
  /** @type {Record<string, unknown>} */
  const changes = {};
  for (const name of Object.keys(inner(canvas)._fullLayout ?? {}).filter(isAxis)) {
    const ends = zoom.get(name);
    if (ends) [changes[`${name}.range[0]`], changes[`${name}.range[1]`]] = ends;
    else if (inner(canvas).layout?.[name]?.autorange === false) changes[`${name}.autorange`] = true;
  }
  if (Object.keys(changes).length) await (await load()).relayout(canvas, changes);
}

/** @param {string} name @returns {name is AxisName} */
const isAxis = (name) => /^[xy]axis\d*$/.test(name);

/** Fit a drawn figure to its place. @param {Canvas} canvas @param {{ width: number, height: number, autosize: boolean }} size */
export function fit(canvas, size) {
  const drawn = inner(canvas)._fullLayout;
  if (drawn && (drawn.width !== size.width || drawn.height !== size.height)) window.Plotly?.relayout(canvas, size);
}

/** Take a drawn figure away. @param {Canvas} canvas */
export function clear(canvas) {
  if (isDrawn(canvas)) window.Plotly?.purge(canvas);
}

/** An image of a figure, as an address. @param {Figure} figure @param {number} height */
export const makeImage = async (figure, height) => (await load()).toImage(figure, { format: "png", height, ...IMAGE });
