/** Identifiers and hashes are copied by a click or Enter: every element with data-copy. */
import { around, findAll } from "./dom.js";

/** @param {HTMLElement} element */
function prepare(element) {
  if (element.matches("button")) return; // says itself what it copies
  element.tabIndex = 0;
  element.setAttribute("role", "button");
  element.setAttribute("aria-label", `Copy ${element.dataset.copy}`);
}

/** @param {Event} event */
async function copy(event, selector = "[data-copy]") {
  const element = around(event, selector);
  if (!element) return;
  await navigator.clipboard.writeText(element.dataset.copy ?? "");
  element.classList.add("copied");
  setTimeout(() => element.classList.remove("copied"), 1200);
}

if (navigator.clipboard) {
  for (const element of findAll("[data-copy]", HTMLElement)) prepare(element);
  document.addEventListener("click", (event) => copy(event));
  document.addEventListener("keydown", (event) => {
    if (event.key === "Enter") copy(event, "[data-copy]:not(button)");
  });
}
