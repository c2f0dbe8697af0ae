/**
 * The surface of a figure. Figures arrive in the dark template and carry those of the other themes in `layout.meta`:
 * a page shows its own, paper and every exported image the light one, black on white.
 */

const theme = () => (matchMedia("print").matches ? "light" : document.documentElement.dataset.theme);

function copied(figure, template) {
  const layout = { ...structuredClone(figure.layout) };
  if (template) layout.template = structuredClone(template);
  return { data: structuredClone(figure.data), layout };
}

const HEADING_PX = 28;

/** The figure as this page shows it: on the panel's own surface, and without its title, which the panel's heading is. */
export function onTheme(figure) {
  const themed = copied(figure, figure.layout.meta?.[theme()]);
  themed.layout.title = { text: "" };
  themed.layout.legend = { ...themed.layout.legend, y: 1 };
  themed.layout.margin = { ...themed.layout.margin, t: Math.max(24, (themed.layout.margin?.t ?? 64) - HEADING_PX) };
  themed.layout.paper_bgcolor = "rgba(0,0,0,0)";
  themed.layout.plot_bgcolor = "rgba(0,0,0,0)";
  return themed;
}

/** The figure for an image: white whatever the page's theme. */
export function onWhite(figure) {
  const white = copied(figure, figure.layout.meta?.light);
  return { ...white, layout: { ...white.layout, paper_bgcolor: "#ffffff", plot_bgcolor: "#ffffff" } };
}
