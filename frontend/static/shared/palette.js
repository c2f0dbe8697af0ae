/**
 * The palette: Ctrl-K (or ⌘-K) finds favourites and saved views, sensors, runs, sets, requests, telemetry and alarms by name or number, settings, terms, pages, and
 * the links and buttons of the page at hand. It leads to places, opens dialogs and presses what only shows; a button that would send a
 * form that writes gets the focus and is not pressed.
 */
import { find, findAll } from "./dom.js";
import { describeError, fetchJson } from "./requests.js";
import { listViews } from "./saved-views.js";

const QUIET_MS = 150;
const HERE = "main .tabs a[href], main .page-head a.button[href], main .next-act a[href], main .contents a[href]";
const COMMANDS = "main button, #theme, footer button, header form[action='/logout'] button";
const NO_COMMAND = "table button, .notice button, .field button, main [data-save-view]";
/** @typedef {{ kind: string, title: string, note: string, href: string, button?: HTMLButtonElement }} Found */

/** What a link or a button is called. @param {HTMLElement} control */
const getName = (control) => {
  const counted = find(".badge", HTMLElement, control)?.textContent ?? "";
  return (control.ariaLabel || (control.textContent ?? "").trim().replace(new RegExp(`${counted}$`), "") || control.title).trim().replace(/\s+/g, " ");
};

/** The buttons of this page that can be pressed. @returns {Found[]} */
function listCommands() {
  const buttons = findAll(COMMANDS, HTMLButtonElement).filter((one) => !one.disabled && one.checkVisibility() && !one.matches(NO_COMMAND));
  return buttons.map((button) => ({ kind: "Command", title: getName(button), note: writes(button) ? "shows it" : "", href: "", button }));
}

/** @param {HTMLButtonElement} button */
const writes = (button) => button.type === "submit" && button.form?.getAttribute("method") === "post";

/** Press a button, or only show the one that writes. @param {HTMLButtonElement} button */
function take(button) {
  button.focus();
  if (writes(button)) button.scrollIntoView({ block: "center" });
  else button.click();
}

class Palette {
  #timer = 0;
  #asked = 0;
  #at = 0;
  /** @type {Found[]} favourites and saved views */
  #saved = [];

  /** @param {HTMLDialogElement} dialog @param {HTMLInputElement} field @param {HTMLElement} list */
  constructor(dialog, field, list) {
    this.dialog = dialog;
    this.field = field;
    this.list = list;
    field.addEventListener("input", () => this.#typed());
    field.addEventListener("keydown", (event) => this.#key(event));
    list.addEventListener("click", () => dialog.close());
  }

  open() {
    this.field.value = "";
    this.dialog.showModal();
    this.field.focus();
    this.#show(this.#near(""));
    listViews().then((saved) => {
      this.#saved = saved;
      if (!this.field.value) this.#show(this.#near(""));
    });
  }

  /** Pages, and links and buttons of this page, that contain the text. @param {string} text @returns {Found[]} */
  #near(text) {
    const wanted = text.toLowerCase();
    /** @param {string} kind @param {string} selector */
    const links = (kind, selector) =>
      findAll(selector, HTMLAnchorElement).map((link) => ({ kind, title: getName(link), note: "", href: link.href }));
    const all = [...this.#saved, ...links("Here", HERE), ...listCommands(), ...links("Page", "nav.side a[href]")];
    return all.filter((one) => one.title.toLowerCase().includes(wanted));
  }

  #typed() {
    const text = this.field.value.trim();
    const asked = (this.#asked += 1);
    clearTimeout(this.#timer);
    this.#show(this.#near(text));
    if (!text) return;
    this.#timer = setTimeout(async () => {
      /** @type {Found[]} */
      let found = [];
      let said = "";
      try {
        found = (await fetchJson(`/search?q=${encodeURIComponent(text)}`)).found;
      } catch (error) {
        said = describeError(error);
      }
      if (asked !== this.#asked) return;
      const near = this.#near(text);
      const saved = near.filter((one) => this.#saved.includes(one));
      const all = [...saved, ...found, ...near.filter((one) => !saved.includes(one))];
      const places = all.map((one) => one.href && new URL(one.href, location.href).href);
      this.#show(all.filter((one, at) => !one.href || places.indexOf(places[at] ?? "") === at), said);
    }, QUIET_MS);
  }

  /** @param {Found[]} found @param {string} [said] */
  #show(found, said = "") {
    this.#at = 0;
    this.list.replaceChildren(...found.map((one, place) => this.#option(one, place)));
    const status = find("#palette-said", HTMLElement, this.dialog);
    if (status) status.textContent = said || (found.length ? `${found.length} found` : "Nothing found with this name.");
    this.#mark();
  }

  /** @param {Found} one @param {number} place */
  #option(one, place) {
    const { button } = one;
    const link = Object.assign(document.createElement("a"), { id: `palette-${place}`, tabIndex: -1 });
    if (!button) link.href = one.href;
    else link.addEventListener("click", () => setTimeout(() => take(button))); // when the palette has closed and given back the focus
    link.setAttribute("role", "option");
    for (const [name, text] of Object.entries({ "palette-kind": one.kind, "palette-title": one.title, "palette-note": one.note })) {
      const part = document.createElement("span");
      part.className = name;
      part.textContent = text;
      link.append(part);
    }
    return link;
  }

  #mark() {
    const options = findAll("[role=option]", HTMLElement, this.list);
    options.forEach((one, place) => one.setAttribute("aria-selected", String(place === this.#at)));
    const here = options[this.#at];
    if (here) this.field.setAttribute("aria-activedescendant", here.id);
    else this.field.removeAttribute("aria-activedescendant");
    here?.scrollIntoView({ block: "nearest" });
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const count = this.list.children.length;
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (event.key === "Escape") this.dialog.close(); // Escape in a search field would only empty it
    else if (step && count) {
      event.preventDefault();
      this.#at = (this.#at + step + count) % count;
      this.#mark();
    } else if (event.key === "Enter") {
      event.preventDefault();
      const chosen = this.list.children[this.#at];
      if (chosen instanceof HTMLElement) chosen.click();
    }
  }
}

const [dialog, field, list] = [find("#palette", HTMLDialogElement), find("#palette-text", HTMLInputElement), find("#palette-list", HTMLElement)];
if (dialog && field && list) {
  const palette = new Palette(dialog, field, list);
  const opener = find("#palette-open", HTMLButtonElement);
  if (opener) opener.hidden = false;
  opener?.addEventListener("click", () => palette.open());
  document.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "k" || !(event.ctrlKey || event.metaKey) || event.altKey || event.shiftKey) return;
    event.preventDefault();
    if (!dialog.open) palette.open();
  });
}
