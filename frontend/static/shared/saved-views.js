/**
 * Saving the view that a page shows, its whole address with what is filtered, zoomed and marked, and the star that makes the page of
 * a sensor, run, set or request a favourite.
 */
import { around, find, findAll, need } from "./dom.js";
import { BACKGROUND, fetchJson } from "./requests.js";

const OF_AN_OBJECT = /^\/(sensors|runs|parameter-sets|approvals)\/\d+$/;
/** @typedef {{ kind: string, title: string, note: string, href: string, own: boolean }} SavedView */

/** Favourites, own views and shared ones; none where they cannot be read. @returns {Promise<SavedView[]>} */
export const listViews = async () => (await fetchJson("/saved-views/known", BACKGROUND).catch(() => ({ found: [] }))).found;

const getTitle = () => (find("main h1", HTMLElement)?.textContent ?? document.title).trim().replace(/\s+/g, " ").slice(0, 80);

/** @param {HTMLFormElement} form @param {string} path */
function fill(form, path) {
  need("input[name=path]", HTMLInputElement, form).value = path;
  need("input[name=name]", HTMLInputElement, form).value = getTitle();
}

async function showStar() {
  const star = need("#favourite", HTMLFormElement);
  fill(star, location.pathname);
  const views = await listViews();
  const isOne = views.some((one) => one.own && one.href === location.pathname);
  const button = need("button", HTMLButtonElement, star);
  button.textContent = isOne ? "★" : "☆";
  button.setAttribute("aria-pressed", String(isOne));
  star.hidden = false;
}

for (const opener of findAll("[data-save-view]", HTMLButtonElement)) opener.hidden = false;
document.addEventListener("click", (event) => {
  if (!around(event, "[data-save-view]")) return;
  const dialog = need("#save-view", HTMLDialogElement);
  fill(need("form", HTMLFormElement, dialog), location.pathname + location.search + location.hash);
  dialog.showModal();
  need("#view-name", HTMLInputElement, dialog).select();
});
need("#save-view-leave", HTMLButtonElement).addEventListener("click", () => need("#save-view", HTMLDialogElement).close());
if (OF_AN_OBJECT.test(location.pathname)) showStar();
