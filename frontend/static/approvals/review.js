/**
 * The review of a request: a figure is fetched when its view is first opened and counts as opened when it stood in sight for a
 * second, which the server is told; who asks for all figures is led from one to the next as each counts; a reason that is typed ticks its
 * point, and the panel counts the points that are open, with which nothing is approved. The server decides all the same what is missing.
 */
import { around, find, findAll, make, need } from "../shared/dom.js";
import { Problem, send } from "../shared/requests.js";

const IN_SIGHT_MS = 1100; // the server asks for a second since it gave the figure
const IN_SIGHT = 0.5; // of the figure, or of the window where that is smaller

const panel = find("#sign", HTMLElement);

/** The ticks of the points that nothing closed yet. */
function listOpen() {
  const boxes = findAll('.point input[type="checkbox"]', HTMLInputElement);
  return boxes.filter((box) => {
    const reason = find(".reason", HTMLInputElement, box.parentElement ?? document);
    return !box.closest("[data-closed]") && !(box.checked && reason?.value.trim());
  });
}

/** The reason that is typed next, which ticks its point. */
function findOpenReason() {
  const first = listOpen()[0];
  return first ? find(".reason", HTMLInputElement, first.parentElement ?? document) : null;
}

function showCount() {
  const left = find("[data-left]", HTMLElement);
  const count = listOpen().length;
  const said = `${count} point${count === 1 ? "" : "s"} open`;
  if (left) left.textContent = said;
  for (const place of findAll("[data-points-left]", HTMLElement)) {
    place.hidden = count === 0;
    place.replaceChildren(`${said}: before signing, acknowledge each with a reason, or open the figure. `, make("a", { href: "#sign", textContent: "To the first open point" }));
    // refused, it would cost the password; the server decides all the same
    const button = find("button[value=APPROVE]", HTMLButtonElement, place.closest("dialog") ?? document);
    if (button) button.disabled = count > 0;
  }
}

let isLed = false;

function openViews() {
  for (const one of findAll("[data-view]", HTMLDetailsElement)) one.open = true;
}

/** Show the next figure that does not count as opened yet, while the person is led through them. */
function leadOn() {
  const next = findAll("[data-view]", HTMLDetailsElement).find((view) => find("[data-opened]", HTMLElement, view)?.textContent !== "opened");
  if (isLed) (next?.querySelector("plot-figure") ?? next)?.scrollIntoView({ block: "center" });
  isLed &&= next !== undefined;
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
    if (label) label.textContent = label.textContent?.replace("Sign without opening the figure ", "Opened: ") ?? "";
  }
  const views = findAll("[data-view] [data-opened]", HTMLElement);
  const heading = find("#views-title + p", HTMLElement);
  if (heading) heading.textContent = `${views.filter((one) => one.textContent === "opened").length} of ${views.length} opened by you`;
  showCount();
  leadOn();
}

/** Tell the server that a figure stood in sight. @param {string} name */
async function tellShown(name) {
  const token = need("#sign-form input[name=csrf_token], input[name=csrf_token]", HTMLInputElement).value;
  const headers = { "Content-Type": "application/json", "X-CSRF-Token": token };
  try {
    await send(`/api/v1${location.pathname}/openings`, { method: "POST", headers, body: JSON.stringify({ evidence: name }) });
    markOpened(name);
    return true;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    return false; // such as a server that is away: it is told when the figure is in sight again
  }
}

/** Count a drawn figure as opened once it stood in sight long enough. @param {Element} figure @param {string} name */
function watchInSight(figure, name) {
  let timer = 0;
  const seen = () => {
    const { top, bottom, height } = figure.getBoundingClientRect();
    const shown = Math.min(bottom, innerHeight) - Math.max(top, 0);
    return height > 0 && !document.hidden && shown >= IN_SIGHT * Math.min(height, innerHeight);
  };
  const look = () => {
    clearTimeout(timer);
    if (seen()) timer = setTimeout(async () => { if (seen() && await tellShown(name)) stop(); }, IN_SIGHT_MS);
  };
  const observer = new IntersectionObserver(look, { threshold: [0, 0.25, 0.5, 0.75, 1] });
  const stop = () => {
    observer.disconnect();
    document.removeEventListener("visibilitychange", look);
  };
  document.addEventListener("visibilitychange", look);
  observer.observe(figure);
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
    if (!figure || !find("[data-left]", HTMLElement) || find("[data-opened]", HTMLElement, view)?.textContent === "opened") return;
    new MutationObserver((_, watch) => {
      if (figure.getAttribute("data-state") !== "ready" && figure.getAttribute("data-state") !== "empty") return;
      watch.disconnect();
      watchInSight(figure, view.dataset.view ?? "");
      leadOn(); // what was drawn above it moved it
    }).observe(figure, { attributeFilter: ["data-state"] });
  });
}

document.addEventListener("click", (event) => {
  const link = around(event, "[data-open-view]");
  const view = link instanceof HTMLElement ? find(`[data-view="${link.dataset.openView}"]`, HTMLDetailsElement) : null;
  if (view) view.open = true;
  isLed = around(event, "[data-lead-views]") !== null;
  if (isLed) event.preventDefault();
  if (isLed || around(event, "[data-open-views]")) openViews();
  if (isLed) setTimeout(leadOn); // once they are unfolded
  const toPoint = around(event, "[data-points-left] a");
  if (!toPoint) return;
  event.preventDefault();
  toPoint.closest("dialog")?.close();
  findOpenReason()?.focus();
});
for (const own of ["wheel", "touchmove", "keydown"]) addEventListener(own, () => { isLed = false; }, { passive: true }); // who moves by themselves is not led

panel?.addEventListener("input", ({ target }) => {
  if (target instanceof HTMLInputElement && target.matches(".reason")) {
    const box = find('input[type="checkbox"]', HTMLInputElement, target.parentElement ?? document);
    if (box) box.checked = target.value.trim() !== "";
  }
  showCount();
});

/** The panel ends with the window wherever it begins, so that the buttons that sign are in sight. */
function fitPanel() {
  if (panel) panel.style.setProperty("--from", `${Math.max(panel.getBoundingClientRect().top, 0)}px`);
}
addEventListener("scroll", fitPanel, { passive: true });
addEventListener("resize", fitPanel);
fitPanel();
showCount();
if (["#review", "#sign"].includes(location.hash) && panel) { // who comes to sign has the figures before them, and the first reason to type
  openViews();
  findOpenReason()?.focus({ preventScroll: true });
}
