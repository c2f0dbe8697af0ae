// Gives the parts of a page that carry `data-live` and an id the server's newest words, without disturbing who uses them:
// a part that is being typed in or pressed stays as it is until the next time; in the others the focus stays on the same
// control, foldings stay open, tables and logs stay scrolled. No state is kept here.

const CONTROLS = "a[href], button, summary, [tabindex]";
const SCROLLED = ".scroll, .log";
const TYPED = "input, textarea, select";

const isUsed = (part) => part.matches(":active") || (part.contains(document.activeElement) && document.activeElement.matches(TYPED));

/** What makes a control the same one after the part was renewed. */
const nameOf = (control) =>
  [control.localName, control.id || control.getAttribute("href") || control.getAttribute("aria-label") || control.textContent.trim()].join(" ");

const namesakes = (part, name) => [...part.querySelectorAll(CONTROLS)].filter((control) => nameOf(control) === name);

/** Remember which control has the focus; return what gives it back. */
function keepFocus(part) {
  const focused = document.activeElement;
  if (focused === part || !part.contains(focused)) return () => {};
  const name = nameOf(focused);
  const place = namesakes(part, name).indexOf(focused);
  return () => namesakes(part, name)[place]?.focus({ preventScroll: true });
}

/** Remember which foldings are open and how far tables and logs were scrolled; return what restores that. */
function keepView(part) {
  const open = [...part.querySelectorAll("details")].map((details) => details.open);
  const places = [...part.querySelectorAll(SCROLLED)].map((one) => [one.scrollLeft, one.scrollTop]);
  return () => {
    for (const [k, details] of part.querySelectorAll("details").entries()) details.open = open[k] ?? details.open;
    for (const [k, one] of part.querySelectorAll(SCROLLED).entries()) one.scrollTo(...(places[k] ?? [0, 0]));
  };
}

/** Remember what was typed into fields; return what gives it back. */
function keepTyped(part) {
  const typed = [...part.querySelectorAll("input[id], textarea[id]")].filter((field) => field.value !== field.defaultValue);
  return () => {
    for (const { id, value } of typed) if (document.getElementById(id)) document.getElementById(id).value = value;
  };
}

/** Renew a part; say whether it now is as the server has it. */
function renew(part, fresh) {
  if (!fresh || part.innerHTML === fresh.innerHTML) return true;
  if (isUsed(part)) return false;
  const restores = [keepView(part), keepTyped(part), keepFocus(part)];
  part.replaceChildren(...fresh.childNodes);
  for (const restore of restores) restore();
  return true;
}

/** Renew every live part of the page from a newer copy of the page; say whether none had to be left as it was. */
export function renewParts(fresh) {
  return [...document.querySelectorAll("[data-live][id]")].map((part) => renew(part, fresh.getElementById(part.id))).every(Boolean);
}
