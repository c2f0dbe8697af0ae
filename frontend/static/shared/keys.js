/**
 * Keys: `g` and a letter go to a page, the others move within one, open, choose, compare, copy. `?` lists them (the list is
 * KEYS of the page frame) and switches them off. They never act while something is typed, and never on what a form would
 * send: no key signs, promotes, rolls back, cancels or deletes.
 */
import { find, findAll, need } from "./dom.js";

const WAIT_MS = 1500;
const SAID_MS = 2500;
const STORED = "boresight-keys";
const TYPED = "input:not([type=checkbox], [type=radio]), form.ask input, textarea, select, [contenteditable]";
const list = find("#keys", HTMLDialogElement);
let goAt = -WAIT_MS;

const isOn = () => localStorage.getItem(STORED) !== "off";
/** @param {EventTarget | null} target */
const isTyping = (target) => target instanceof Element && target.closest(TYPED) !== null;
/** @param {string} place */
const first = (place) => find(`main ${place}`, HTMLElement);
const rowHere = () => document.activeElement?.closest("tbody tr") ?? null;

/** @param {string} words */
function say(words) {
  const said = need("#keys-said", HTMLElement);
  said.textContent = words;
  setTimeout(() => { said.textContent = ""; }, SAID_MS);
}

function show() {
  need("#keys-on", HTMLInputElement).checked = isOn();
  list?.showModal();
}

/** @param {string} selector */
function follow(selector) {
  const link = document.querySelector(selector);
  if (link instanceof HTMLAnchorElement) link.click(); // a press, which is held while disconnected
  else if (link instanceof HTMLLinkElement) location.assign(link.href);
}

/** Press a link or a box; what belongs to a form that changes something is left alone. @param {HTMLElement | null | undefined} control */
function press(control) {
  if (control && !control.closest("form[method=post]")) control.click();
}

/** @param {number} by */
function stepRow(by) {
  const rows = findAll("main table tbody tr:has(a[href])", HTMLTableRowElement).filter((row) => row.checkVisibility());
  const here = rows.findIndex((row) => row === rowHere());
  const next = rows[here < 0 ? 0 : Math.min(Math.max(here + by, 0), rows.length - 1)];
  if (next) find("th a[href], a[href]", HTMLElement, next)?.focus();
}

/** @param {KeyboardEvent} event */
function choose(event) {
  const box = rowHere()?.querySelector("input[type=checkbox][name=runs]");
  box?.dispatchEvent(new MouseEvent("click", { bubbles: true, cancelable: true, shiftKey: event.shiftKey }));
}

async function copyAddress() {
  try {
    await navigator.clipboard.writeText(location.href);
    say("The address of this view was copied.");
  } catch {
    say("Clipboard access is blocked; copy the address from the browser's address bar.");
  }
}

/** @param {KeyboardEvent} event */
function leave(event) {
  const picker = find("details.picker[open]", HTMLDetailsElement);
  if (picker) picker.open = false;
  if (event.target instanceof HTMLElement && isTyping(event.target)) event.target.blur();
}

/** @type {Record<string, (event: KeyboardEvent) => void>} */
const ACTIONS = {
  "?": show,
  "/": () => first(".filters :is(input:not([type=hidden], [type=checkbox]), select), input[type=search]")?.focus(),
  j: () => stepRow(1),
  k: () => stepRow(-1),
  x: choose,
  X: choose,
  c: () => press(first("[data-compare]:not([disabled])")),
  "[": () => follow("a[rel~=prev][href], link[rel~=prev][href]"),
  "]": () => follow("a[rel~=next][href], link[rel~=next][href]"),
  d: () => press(first("[data-hotkey=d]")),
  e: () => press(first("[data-hotkey=e]") ?? first("a[download]")),
  y: copyAddress,
};

/** @param {KeyboardEvent} event */
function act(event) {
  const { key } = event;
  if (key === "Escape") return leave(event);
  if (!isOn() || event.ctrlKey || event.altKey || event.metaKey || isTyping(event.target) || list?.open) return undefined;
  const waiting = event.timeStamp - goAt < WAIT_MS; // when the keys were pressed, however busy the page was meanwhile
  goAt = key === "g" ? event.timeStamp : -WAIT_MS;
  if (key === "g") return undefined;
  if (waiting) return follow(`nav.side a[data-key="${CSS.escape(key)}"]`);
  if (/^[1-9]$/.test(key)) return press(findAll("main .tabs a", HTMLElement)[Number(key) - 1]);
  const action = Object.hasOwn(ACTIONS, key) ? ACTIONS[key] : null;
  if (action) event.preventDefault();
  return action?.(event);
}

if (list) {
  const [opener, onSwitch] = [need("#keys-open", HTMLElement), need("#keys-on", HTMLInputElement)];
  opener.hidden = false;
  opener.addEventListener("click", show);
  onSwitch.addEventListener("change", () => localStorage.setItem(STORED, onSwitch.checked ? "on" : "off"));
  document.addEventListener("keydown", act);
}

const menu = find("#menu-open", HTMLButtonElement);
menu?.addEventListener("click", () => menu.setAttribute("aria-expanded", String(menu.getAttribute("aria-expanded") === "false")));
