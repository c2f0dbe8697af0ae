/** Rows or tiles on the overview: what was chosen last in this browser is shown where the address does not say. */
import { around } from "../shared/dom.js";

const KEY = "boresight:overview-view";

document.addEventListener("click", (event) => {
  const link = around(event, "[data-overview-view]");
  if (link instanceof HTMLElement) localStorage.setItem(KEY, link.dataset.overviewView ?? "rows");
});

if (!new URLSearchParams(location.search).has("view") && localStorage.getItem(KEY) === "tiles") location.replace("/?view=tiles");
