/**
 * Disconnected means disarmed: while the server is not heard every button that would write is held with its reason, a banner
 * says since when, and what was typed stays; links within the console are held too, which would end there. A form is sent only once the server has answered, so that none ends on the
 * browser's own page. When the link is back the buttons are released; a page without live parts in which nothing was typed
 * is read again, the others are caught up by live-page.js.
 */
import { roughSpan } from "./clock.js";
import { around, find, findAll, make, need } from "./dom.js";

const ANSWER_WITHIN_MS = 5000;
const TYPED = "input:not([type=hidden], [type=submit]), textarea, select";
/** Buttons that were alive when the link broke, with the title that each had. @type {Map<HTMLButtonElement, string>} */
const held = new Map();
/** Forms that the server has been asked for. @type {WeakSet<HTMLFormElement>} */
const cleared = new WeakSet();
/** Links within the console that are held, with their titles. @type {Map<HTMLAnchorElement, string>} */
const heldLinks = new Map();
let sinceMs = 0;
let isHeld = false;
let reason = "";

/** Asked of the attribute: a field named "method", as the launch form has, hides the form's own. @param {HTMLFormElement | null} form */
const isPost = (form) => form?.getAttribute("method") === "post";

/** @param {HTMLButtonElement} button */
const writes = (button) => button.hasAttribute("data-act") || (button.type === "submit" && isPost(button.form));

function tick() {
  if (!isHeld) return;
  const age = roughSpan(Math.max(0, Math.round((Date.now() - sinceMs) / 1000)));
  document.body.style.setProperty("--link-age", `"${age} old"`);
  const place = find("#link-age", HTMLElement);
  if (place) place.textContent = age;
  if (isLinkHeld()) holdLinks();
  holdButtons(); // those too that came or were released meanwhile
}

function holdButtons() {
  for (const button of findAll("button", HTMLButtonElement)) {
    if (button.disabled || !writes(button)) continue;
    held.set(button, button.title);
    button.disabled = true;
    button.title = reason;
  }
}

/** Whether a link asks the server for anything. @param {HTMLAnchorElement} link */
const leaves = (link) => link.origin === location.origin && !link.closest("#log-in-ended") && !(link.hash && link.pathname + link.search === location.pathname + location.search);

const isLinkHeld = () => document.body.hasAttribute("data-links-held");

function holdLinks() {
  for (const link of findAll("a[href]", HTMLAnchorElement)) {
    if (heldLinks.has(link) || !leaves(link)) continue;
    heldLinks.set(link, link.title);
    link.setAttribute("aria-disabled", "true");
    link.title = reason;
  }
}

/** Lead to the banner, which says why. @param {Event} event */
function refuse(event) {
  event.preventDefault();
  find(".link-banner", HTMLElement)?.focus();
}

/** @param {LinkState} link */
function hold(link) {
  if (!isHeld) sinceMs = link.sinceMs;
  isHeld = true;
  const isOut = link.state === "logged-out";
  reason = isOut ? "You are logged out: log in again, then try again." : "Disconnected: the server does not answer. Wait until the link is back, then try again.";
  find(".link-banner", HTMLElement)?.remove();
  document.body.toggleAttribute("data-links-held", !isOut);
  if (!isOut) {
    const banner = make("div", { className: "notice link-banner", role: "alert", tabIndex: -1 });
    const words = make("p", {});
    const [at, age] = [make("time", { dateTime: new Date(sinceMs).toISOString() }), make("span", { id: "link-age" })];
    at.textContent = `${at.dateTime.slice(11, 19)}Z`;
    age.setAttribute("aria-hidden", "true");
    words.append(make("b", { textContent: "DISCONNECTED" }), " since ", at, " (", age, "). All states shown are from that time. Buttons that change anything and links within the console are disabled; what you typed is kept.");
    banner.append(words);
    need("#content", HTMLElement).prepend(banner);
  }
  tick();
}

function release() {
  isHeld = false;
  find(".link-banner", HTMLElement)?.remove();
  document.body.style.removeProperty("--link-age");
  document.body.removeAttribute("data-links-held");
  for (const [link, title] of heldLinks) {
    link.removeAttribute("aria-disabled");
    link.title = title;
    if (!title) link.removeAttribute("title");
  }
  heldLinks.clear();
  for (const [button, title] of held) {
    button.disabled = false;
    button.title = title;
    if (!title) button.removeAttribute("title");
  }
  held.clear();
  if (!find("[data-live]", HTMLElement) && !find("[data-launch]", HTMLElement) && !isUsed()) location.reload();
}

/** Whether anything was typed or chosen, or a dialog is open. */
function isUsed() {
  if (find("dialog[open]", HTMLDialogElement)) return true;
  return findAll(TYPED, HTMLElement, need("#content", HTMLElement)).some((field) => {
    if (field instanceof HTMLInputElement) return field.checked !== field.defaultChecked || field.value !== field.defaultValue;
    if (field instanceof HTMLTextAreaElement) return field.value !== field.defaultValue;
    return field instanceof HTMLSelectElement && [...field.options].some((one) => one.selected !== one.defaultSelected && field.selectedIndex > 0);
  });
}

/** Whether the server answers at all. */
async function answers() {
  try {
    await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(ANSWER_WITHIN_MS) });
    return true;
  } catch {
    return false;
  }
}

/** Send a form once the server has answered. @param {SubmitEvent} event */
async function sendOnceHeard(event) {
  const { target: form, submitter } = event;
  if (!(form instanceof HTMLFormElement) || event.defaultPrevented) return;
  if (isLinkHeld() && form.getAttribute("method") !== "dialog") return refuse(event);
  if (!isPost(form)) return;
  if (cleared.delete(form)) return;
  event.preventDefault();
  if (isHeld || form.hasAttribute("aria-busy")) return;
  form.setAttribute("aria-busy", "true"); // pressed twice, it is sent once
  const isThere = await answers();
  form.removeAttribute("aria-busy");
  if (!isThere) {
    document.dispatchEvent(new CustomEvent("boresight:doubt"));
    return;
  }
  cleared.add(form);
  form.requestSubmit(submitter instanceof HTMLButtonElement && !submitter.disabled ? submitter : null);
}

document.addEventListener("boresight:link", ({ detail }) => {
  if (["disconnected", "logged-out"].includes(detail.state)) hold(detail);
  else if (isHeld) release();
});
document.addEventListener("submit", sendOnceHeard);
document.addEventListener("click", (event) => {
  const link = around(event, "a[href]");
  if (isLinkHeld() && link instanceof HTMLAnchorElement && leaves(link)) refuse(event);
}, true);
setInterval(tick, 1000);
