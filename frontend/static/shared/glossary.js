/**
 * What a term means, under the pointer and at the focus: the meaning stands at the link to the glossary that the term is, or at
 * the button that sorts its column. It stays while the pointer is over the term or over the meaning, and Escape takes it away.
 */
import { around, find, make, need } from "./dom.js";

const GAP_PX = 4;
const tip = make("div", { id: "term-tip", className: "term-tip", role: "tooltip", popover: "manual" });
/** @type {Element | null} */
let shown = null;

/** @param {Element} term */
function show(term) {
  if (term === shown) return;
  hide();
  shown = term;
  // what is open as a modal dialog lies over all that is not in it
  (find("dialog:modal", HTMLDialogElement) ?? need("#content", HTMLElement)).append(tip);
  tip.textContent = term.getAttribute("data-meaning");
  term.setAttribute("aria-describedby", tip.id);
  tip.showPopover();
  const [{ left, top, bottom }, own] = [term.getBoundingClientRect(), tip.getBoundingClientRect()];
  const isBelow = bottom + GAP_PX + own.height <= innerHeight;
  tip.style.left = `${Math.max(GAP_PX, Math.min(left, innerWidth - own.width - GAP_PX))}px`;
  tip.style.top = `${isBelow ? bottom + GAP_PX : Math.max(GAP_PX, top - own.height - GAP_PX)}px`;
}

function hide() {
  shown?.removeAttribute("aria-describedby");
  shown = null;
  if (tip.matches(":popover-open")) tip.hidePopover();
}

/** @param {Event} event */
const enter = (event) => {
  const term = around(event, "[data-meaning]");
  if (term) show(term);
};

/** @param {EventTarget | null} to */
const leave = (to) => {
  if (!(to instanceof Element && (to === shown || shown?.contains(to) || to === tip)) && document.activeElement !== shown) hide();
};

document.addEventListener("pointerover", enter);
document.addEventListener("focusin", enter);
document.addEventListener("pointerout", ({ relatedTarget }) => shown && setTimeout(() => leave(find(":hover:is([data-meaning], .term-tip)", HTMLElement) ?? relatedTarget), 120));
document.addEventListener("focusout", hide);
document.addEventListener("keydown", ({ key }) => key === "Escape" && hide());
addEventListener("scroll", hide, { capture: true, passive: true });
