// Saves a drawing of the server as a PNG on white, whatever the theme: buttons with data-save="file name".

const SCALE = 2;
const PAPER = [
  [".bar", { fill: "#5b9bd5" }],
  [".cell-empty", { fill: "none", stroke: "#999999" }],
  [".axis", { fill: "none", stroke: "#444444" }],
  [".gridline", { stroke: "#dddddd" }],
  [".mark-line", { fill: "none", stroke: "#a85b00", "stroke-dasharray": "4 3" }],
  ["text", { fill: "#111111", "font-size": "11px", "font-family": "sans-serif" }],
  ["text.cell-text", { "font-size": "9.5px" }],
];

/** The drawing with the colours of paper written into it. */
function onPaper(drawing) {
  const copy = drawing.cloneNode(true);
  copy.removeAttribute("class");
  for (const [selector, colours] of PAPER) {
    for (const element of copy.querySelectorAll(selector)) {
      for (const [name, value] of Object.entries(colours)) element.setAttribute(name, value);
    }
  }
  const { width, height } = drawing.viewBox.baseVal;
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", width * SCALE);
  copy.setAttribute("height", height * SCALE);
  return { text: new XMLSerializer().serializeToString(copy), width: width * SCALE, height: height * SCALE };
}

async function save(button) {
  const { text, width, height } = onPaper(button.closest("section").querySelector("svg.plot"));
  const image = new Image(width, height);
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  await image.decode();
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#ffffff";
  pen.fillRect(0, 0, width, height);
  pen.drawImage(image, 0, 0);
  const link = Object.assign(document.createElement("a"), { href: canvas.toDataURL("image/png"), download: `${button.dataset.save}.png` });
  link.click();
}

for (const button of document.querySelectorAll("button[data-save]")) {
  button.hidden = false;
  button.addEventListener("click", () => save(button));
}
