/**
 * The review of a request: a figure is fetched when its view is first opened, a reason that is typed ticks its point, and the panel
 * counts the points that are open. The server decides all the same what is missing.
 */
import { around, find, findAll } from "../shared/dom.js";

const panel = find("#sign", HTMLElement);

/** The points of the panel that nothing closed yet. */
function countOpen() {
  const boxes = findAll('.point input[type="checkbox"]', HTMLInputElement);
  return boxes.filter((box) => {
    const reason = find(".reason", HTMLInputElement, box.parentElement ?? document);
    return !box.closest("[data-closed]") && !(box.checked && reason?.value.trim());
  }).length;
}

function showCount() {
  const left = find("[data-left]", HTMLElement);
  const count = countOpen();
  if (left) left.textContent = `${count} point${count === 1 ? "" : "s"} open`;
}

/** @param {string} name */
function markOpened(name) {
  const said = find(`[data-view="${name}"] [data-opened]`, HTMLElement);
  if (said) said.textContent = "opened";
  const point = find(`div[data-point="${name}"]`, HTMLElement);
  if (point) {
    point.dataset.closed = "";
    for (const part of point.querySelectorAll("a, .reason")) part.remove();
    const box = find("input", HTMLInputElement, point);
    if (box) {
      box.checked = true;
      box.disabled = true;
    }
    const label = find("label", HTMLLabelElement, point);
    if (label) label.textContent = label.textContent?.replace("Sign without opening ", "Opened: ") ?? "";
  }
  const views = findAll("[data-view] [data-opened]", HTMLElement);
  const heading = find("#views-title + p", HTMLElement);
  if (heading) heading.textContent = `${views.filter((one) => one.textContent === "opened").length} of ${views.length} opened by you`;
  showCount();
}

for (const view of findAll("[data-view]", HTMLDetailsElement)) {
  const small = view.parentElement?.querySelector("plot-figure[small]");
  view.addEventListener("toggle", () => {
    if (view.open) small?.remove(); // the large one is there instead
    else if (small) view.after(small);
    const held = find("template", HTMLTemplateElement, view);
    if (!view.open || !held) return;
    const figure = held.content.querySelector("plot-figure");
    held.replaceWith(held.content);
    if (!figure) return;
    new MutationObserver((_, watch) => {
      if (figure.getAttribute("data-state") !== "ready" && figure.getAttribute("data-state") !== "empty") return;
      watch.disconnect();
      markOpened(view.dataset.view ?? "");
    }).observe(figure, { attributeFilter: ["data-state"] });
  });
}

document.addEventListener("click", (event) => {
  const link = around(event, "[data-open-view]");
  const view = link instanceof HTMLElement ? find(`[data-view="${link.dataset.openView}"]`, HTMLDetailsElement) : null;
  if (view) view.open = true;
  if (around(event, "[data-open-views]")) for (const one of findAll("[data-view]", HTMLDetailsElement)) one.open = true;
});

panel?.addEventListener("input", ({ target }) => {
  if (target instanceof HTMLInputElement && target.matches(".reason")) {
    const box = find('input[type="checkbox"]', HTMLInputElement, target.parentElement ?? document);
    if (box) box.checked = target.value.trim() !== "";
  }
  showCount();
});
showCount();
