// Keys: `g` and a letter go to a page, the others move within one, open, choose, compare, copy. `?` lists them (the list
// is KEYS of boresight.console.pages.frame) and switches them off. They never act while something is typed, and never on what a
// form would send: no key signs, promotes, rolls back, cancels or deletes.

const WAIT_MS = 1500;
const SAID_MS = 2500;
const STORED = "boresight-keys";
const TYPED = "input:not([type=checkbox], [type=radio]), textarea, select, [contenteditable]";
const list = document.getElementById("keys");
const opener = document.getElementById("keys-open");
const onSwitch = document.getElementById("keys-on");
const said = document.getElementById("keys-said");
let goAt = -WAIT_MS;

const isOn = () => localStorage.getItem(STORED) !== "off";
const isTyping = (target) => target.closest(TYPED) !== null;
const first = (place) => document.querySelector(`main ${place}`);
const rowHere = () => document.activeElement.closest("tbody tr");

function say(words) {
  said.textContent = words;
  setTimeout(() => { said.textContent = ""; }, SAID_MS);
}

function show() {
  onSwitch.checked = isOn();
  list.showModal();
}

function go(key) {
  const link = document.querySelector(`nav.side a[data-key="${CSS.escape(key)}"]`);
  if (link) location.assign(link.href);
}

/** Press a link or a box; what belongs to a form that changes something is left alone. */
function press(control) {
  if (control && !control.closest("form[method=post]")) control.click();
}

function stepRow(by) {
  const rows = [...document.querySelectorAll("main table tbody tr:has(a[href])")].filter((row) => row.checkVisibility());
  const here = rows.indexOf(rowHere());
  const next = rows[here < 0 ? 0 : Math.min(Math.max(here + by, 0), rows.length - 1)];
  next?.querySelector("th a[href], a[href]").focus();
}

function choose(event) {
  const box = rowHere()?.querySelector("input[type=checkbox][name=runs]");
  box?.dispatchEvent(new MouseEvent("click", { bubbles: true, cancelable: true, shiftKey: event.shiftKey }));
}

function openRelated(relation) {
  const link = document.querySelector(`a[rel~=${relation}][href], link[rel~=${relation}][href]`);
  if (link) location.assign(link.href);
}

async function copyAddress() {
  try {
    await navigator.clipboard.writeText(location.href);
    say("The address of this view is copied.");
  } catch {
    say("Copy the address from the browser: this page may not write to the clipboard.");
  }
}

function leave(event) {
  const picker = document.querySelector("details.picker[open]");
  if (picker) picker.open = false;
  if (isTyping(event.target)) event.target.blur();
}

const ACTIONS = {
  "?": show,
  "/": () => first(".filters :is(input:not([type=hidden], [type=checkbox]), select), input[type=search]")?.focus(),
  j: () => stepRow(1),
  k: () => stepRow(-1),
  x: choose,
  X: choose,
  c: () => press(first("[data-compare]:not([disabled])")),
  "[": () => openRelated("prev"),
  "]": () => openRelated("next"),
  d: () => press(first("[data-hotkey=d]")),
  e: () => press(first("[data-hotkey=e]") ?? first("a[download]")),
  y: copyAddress,
};

function act(event) {
  if (event.key === "Escape") return leave(event);
  if (!isOn() || event.ctrlKey || event.altKey || event.metaKey || isTyping(event.target) || list.open) return undefined;
  const waiting = event.timeStamp - goAt < WAIT_MS; // when the keys were pressed, however busy the page was meanwhile
  goAt = event.key === "g" ? event.timeStamp : -WAIT_MS;
  if (event.key === "g") return undefined;
  if (waiting) return go(event.key);
  if (/^[1-9]$/.test(event.key)) return press(document.querySelectorAll("main .tabs a")[event.key - 1]);
  const action = Object.hasOwn(ACTIONS, event.key) ? ACTIONS[event.key] : null;
  if (action) event.preventDefault();
  return action?.(event);
}

if (list) {
  opener.hidden = false;
  opener.addEventListener("click", show);
  onSwitch.addEventListener("change", () => localStorage.setItem(STORED, onSwitch.checked ? "on" : "off"));
  document.addEventListener("keydown", act);
}
