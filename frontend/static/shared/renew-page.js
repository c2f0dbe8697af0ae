/**
 * Gives the parts of a page that carry `data-live` and an id the server's newest words, without disturbing who uses them:
 * a part that is being typed in or pressed stays as it is until the next time; in the others the focus stays on the same
 * control, foldings stay open, tables and logs stay scrolled. No state is kept here.
 */
import { findAll } from "./dom.js";
import { fetchPage } from "./requests.js";

const CONTROLS = "a[href], button, summary, [tabindex]";
const SCROLLED = ".scroll, .log";
const TYPED = "input, textarea, select";

/** @param {Element} part */
const isUsed = (part) => part.matches(":active") || (part.contains(document.activeElement) && document.activeElement?.matches(TYPED));

/** What makes a control the same one after the part was renewed. @param {Element} control */
const getName = (control) =>
  [control.localName, control.id || control.getAttribute("href") || control.getAttribute("aria-label") || control.textContent?.trim()].join(" ");

/** @param {Element} part @param {string} name */
const namesakes = (part, name) => findAll(CONTROLS, HTMLElement, part).filter((control) => getName(control) === name);

/** Remember which control has the focus; return what gives it back. @param {Element} part */
function keepFocus(part) {
  const focused = document.activeElement;
  if (!(focused instanceof HTMLElement) || focused === part || !part.contains(focused)) return () => {};
  const name = getName(focused);
  const place = namesakes(part, name).indexOf(focused);
  return () => namesakes(part, name)[place]?.focus({ preventScroll: true });
}

/** Remember which foldings are open and how far tables and logs were scrolled; return what restores that. @param {Element} part */
function keepView(part) {
  const foldings = () => findAll("details", HTMLDetailsElement, part);
  const open = foldings().map((details) => details.open);
  const places = [...part.querySelectorAll(SCROLLED)].map((one) => ({ left: one.scrollLeft, top: one.scrollTop }));
  return () => {
    for (const [k, details] of foldings().entries()) details.open = open[k] ?? details.open;
    for (const [k, one] of part.querySelectorAll(SCROLLED).entries()) one.scrollTo(places[k] ?? { left: 0, top: 0 });
  };
}

/** @param {ParentNode} root */
const typedFields = (root) => [...findAll("input[id]", HTMLInputElement, root), ...findAll("textarea[id]", HTMLTextAreaElement, root)];

/** Remember what was typed into fields; return what gives it back. @param {Element} part */
function keepTyped(part) {
  const typed = new Map(typedFields(part).filter((field) => field.value !== field.defaultValue).map(({ id, value }) => [id, value]));
  return () => {
    for (const field of typedFields(part)) field.value = typed.get(field.id) ?? field.value;
  };
}

/** What the server said last of each part: the part itself may have been sorted, or set closer, since. @type {WeakMap<Element, string>} */
const said = new WeakMap();

/** Renew a part; say whether it now is as the server has it. @param {Element} part @param {Element | null} fresh */
function renew(part, fresh) {
  if (!fresh || [part.innerHTML, said.get(part)].includes(fresh.innerHTML)) return true;
  if (isUsed(part)) return false;
  said.set(part, fresh.innerHTML);
  const restores = [keepView(part), keepTyped(part), keepFocus(part)];
  part.replaceChildren(...fresh.childNodes);
  part.dispatchEvent(new CustomEvent("boresight:renewed", { bubbles: true })); // before the focus is back: rows may move
  for (const restore of restores) restore();
  return true;
}

/**
 * Read the page again and renew its live parts.
 * @returns {Promise<{ fresh: Document, isWhole: boolean } | null>} what was read, and whether no part had to be left as it
 *   was; null where the page could not be read: the link light says so, and the last data stay
 */
export async function renewPage() {
  const fresh = await fetchPage().catch(() => null);
  if (!fresh) return null;
  const isWhole = findAll("[data-live][id]", HTMLElement).map((part) => renew(part, fresh.getElementById(part.id))).every(Boolean);
  return { fresh, isWhole };
}
