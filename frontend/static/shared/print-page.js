/**
 * Printing: a browser that is asked to print lays the page out at once and waits for nothing, so the figures that are not drawn
 * yet are drawn first. They add what to wait for to a `boresight:print` event.
 */
import { findAll, need } from "./dom.js";

const MOST_MS = 60_000; // then it is printed as it is, and what is missing says so

const isAnyLeft = () => findAll("plot-figure[data-state=loading]", HTMLElement).some((figure) => figure.checkVisibility());
const button = need("#print-page", HTMLButtonElement);
const words = button.textContent;

async function printPage() {
  if (button.disabled) return;
  /** @type {Promise<void>[]} */
  const drawings = [];
  button.disabled = true;
  button.textContent = "Drawing every figure …";
  document.dispatchEvent(new CustomEvent("boresight:print", { detail: drawings }));
  await Promise.race([Promise.allSettled(drawings), new Promise((resolve) => setTimeout(resolve, MOST_MS))]);
  button.disabled = false;
  button.textContent = words;
  window.print();
}

button.hidden = false;
button.addEventListener("click", printPage);
document.addEventListener("keydown", (event) => {
  const { key, ctrlKey, metaKey, shiftKey, altKey } = event;
  if (key.toLowerCase() !== "p" || ctrlKey === metaKey || shiftKey || altKey || !isAnyLeft()) return;
  event.preventDefault(); // the browser's own dialog would print what is there
  printPage();
});
