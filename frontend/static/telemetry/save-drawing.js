/** Saves a drawing of the server as a PNG on white, whatever the theme: buttons with data-save="file name". */
import { findAll, make, need } from "../shared/dom.js";

const SCALE = 2;
/** @type {Record<string, Record<string, string>>} */
const PAPER = {
  ".bar": { fill: "#5b9bd5" },
  ".cell-empty": { fill: "none", stroke: "#999999" },
  ".axis": { fill: "none", stroke: "#444444" },
  ".gridline": { stroke: "#dddddd" },
  ".mark-line": { fill: "none", stroke: "#a85b00", "stroke-dasharray": "4 3" },
  text: { fill: "#111111", "font-size": "11px", "font-family": "sans-serif" },
  "text.cell-text": { "font-size": "9.5px" },
};

/** The drawing with the colours of paper written into it. @param {SVGSVGElement} drawing */
function onPaper(drawing) {
  const copy = /** @type {SVGSVGElement} */ (drawing.cloneNode(true));
  copy.removeAttribute("class");
  for (const [selector, colours] of Object.entries(PAPER)) {
    for (const element of copy.querySelectorAll(selector)) {
      for (const [name, value] of Object.entries(colours)) element.setAttribute(name, value);
    }
  }
  const [width, height] = [drawing.viewBox.baseVal.width * SCALE, drawing.viewBox.baseVal.height * SCALE];
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", String(width));
  copy.setAttribute("height", String(height));
  return { text: new XMLSerializer().serializeToString(copy), width, height };
}

/** @param {HTMLButtonElement} button */
async function save(button) {
  const { text, width, height } = onPaper(need("svg.plot", SVGSVGElement, button.closest("section") ?? document));
  const image = new Image(width, height);
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  await image.decode();
  const canvas = make("canvas", { width, height });
  const pen = canvas.getContext("2d");
  if (!pen) return;
  pen.fillStyle = "#ffffff";
  pen.fillRect(0, 0, width, height);
  pen.drawImage(image, 0, 0);
  make("a", { href: canvas.toDataURL("image/png"), download: `${button.dataset.save}.png` }).click();
}

for (const button of findAll("button[data-save]", HTMLButtonElement)) {
  button.hidden = false;
  button.addEventListener("click", () => save(button));
}
