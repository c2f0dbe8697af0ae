/**
 * The surface of a figure. Figures arrive in the dark template and carry those of the other themes in `layout.meta`:
 * a page shows its own, paper and every exported image the light one, black on white.
 */
import { writeTimes } from "./times.js";

const HEADING_PX = 28;
const BAND_OPACITY = 0.4; // in high contrast
let isPaper = false; // the print dialog tells before it lays the page out again, when the media is still the screen
const onPaper = () => isPaper || matchMedia("print").matches;
const isLight = () => onPaper() || document.documentElement.dataset.theme === "light";
const isStrong = () => !onPaper() && document.documentElement.dataset.theme === "contrast";

/** Draw from now on for paper, or for the screen again. @param {boolean} paper */
export const usePaper = (paper) => void (isPaper = paper);
export const isForPaper = () => isPaper;

/** @param {Figure} figure @param {object | undefined} template @returns {Figure} */
function copied(figure, template) {
  const { data, layout } = structuredClone(figure);
  writeTimes({ data, layout });
  return { data, layout: template ? { ...layout, template: structuredClone(template) } : layout };
}

/** Fill and edge a band (`meta.sigmas`) so that it is strong in high contrast. @param {Trace} trace */
function strengthen(trace) {
  if (!trace.meta?.sigmas || !trace.fillcolor) return;
  trace.fillcolor = trace.fillcolor.replace(/[\d.]+\)$/, `${BAND_OPACITY})`);
  trace.line = { ...trace.line, color: trace.fillcolor.replace(/[\d.]+\)$/, "1)"), width: 1.2, dash: "solid" };
}

/**
 * The figure as this page shows it: on the panel's own surface, and without its title, which the panel's heading is.
 * @param {Figure} figure
 */
export function onTheme(figure) {
  const { light, contrast } = figure.layout.meta ?? {};
  const themed = copied(figure, isLight() ? light : isStrong() ? contrast : undefined);
  const { layout } = themed;
  if (layout.title?.text) layout.margin = { ...layout.margin, t: Math.max(24, (layout.margin?.t ?? 64) - HEADING_PX) };
  layout.title = { text: "" };
  layout.legend = { ...layout.legend, y: 1 };
  if (isStrong()) themed.data.forEach(strengthen);
  layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
  return themed;
}

/** The figure for an image: white whatever the page's theme. @param {Figure} figure @returns {Figure} */
export function onWhite(figure) {
  const { data, layout } = copied(figure, figure.layout.meta?.light);
  return { data, layout: { ...layout, paper_bgcolor: "#ffffff", plot_bgcolor: "#ffffff" } };
}
