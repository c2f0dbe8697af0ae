/**
 * Acts with consequences (templates/shared/acts.html): the button opens its dialog as a modal one. A dialog inside a form
 * opens when the form is complete, unless its button sends the form without that check, and no key sends that form past its
 * dialog. Choosing a file opens the dialog that the input names (`data-opens`). One that stands open was refused; one that was opened before this script ran is a popover, and sends its form too.
 */
import { around, find, findAll } from "./dom.js";

/** @param {HTMLDialogElement} dialog */
function open(dialog) {
  const form = dialog.closest("form");
  if (form && !find("button[formnovalidate]", HTMLElement, dialog) && !form.reportValidity()) return;
  dialog.showModal();
  find("input:not([type=hidden]), textarea, select", HTMLElement, dialog)?.focus();
}

document.addEventListener("click", (event) => {
  const button = around(event, "button[popovertarget]");
  const dialog = button && find(`#${CSS.escape(button.getAttribute("popovertarget") ?? "")}`, HTMLDialogElement);
  if (!dialog) return;
  event.preventDefault();
  if (button.hasAttribute("data-act")) open(dialog);
  else dialog.close();
});

/** A link to a dialog of this page opens it at each press, and has the focus again once it is closed. */
document.addEventListener("click", (event) => {
  const link = around(event, 'a[href*="#"]');
  if (!(link instanceof HTMLAnchorElement) || link.hash.length < 2 || link.pathname + link.search !== location.pathname + location.search) return;
  const dialog = find(`#${CSS.escape(link.hash.slice(1))}`, HTMLElement);
  if (!(dialog instanceof HTMLDialogElement) || !dialog.matches(".act-dialog")) return;
  event.preventDefault();
  open(dialog);
});

/** Open the dialog that an input names once a file is chosen. @param {EventTarget | null} input */
function openOf(input) {
  const name = input instanceof HTMLInputElement && input.files?.length ? input.dataset.opens : undefined;
  const dialog = name && find(`#${CSS.escape(name)}`, HTMLDialogElement);
  if (!dialog || dialog.open || !(input instanceof HTMLInputElement)) return;
  showChosen(dialog, input);
  open(dialog);
}

/** Name a chosen file in its dialog, with the SHA-256 where the browser gives one: of two files of one name it tells which. @param {HTMLElement} dialog @param {HTMLInputElement} input */
async function showChosen(dialog, input) {
  const place = find(`[data-chosen="${input.id}"]`, HTMLElement, dialog);
  const file = input.files?.[0];
  if (!place || !file) return;
  place.textContent = `File ${file.name}, ${file.size} bytes`;
  if (!globalThis.crypto?.subtle) return; // not a secure context
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  if (input.files?.[0] !== file) return; // another one was chosen meanwhile
  place.textContent += `, SHA-256 ${Array.from(digest, (one) => one.toString(16).padStart(2, "0")).join("").slice(0, 16)}`;
}

document.addEventListener("change", ({ target }) => openOf(target));
findAll("input[data-opens]", HTMLInputElement).forEach(openOf); // chosen before this script ran

document.addEventListener("submit", (event) => {
  const dialog = event.submitter?.closest("dialog.act-dialog");
  if (dialog instanceof HTMLDialogElement && !dialog.matches("[open], :popover-open")) event.preventDefault();
}, true);

/** Open the dialog, take up the field, or unfold what the address names or has in it: a link leads to it from another page. */
function takeUp() {
  const named = location.hash.length > 1 ? find(`#${CSS.escape(location.hash.slice(1))}`, HTMLElement) : null;
  if (named instanceof HTMLDialogElement && named.matches(".act-dialog") && !named.open) open(named);
  else if (named?.matches("input, textarea, select")) named.focus();
  const within = named?.querySelector(":scope > details.advanced:only-child") ?? named;
  let at = within?.matches("details:not(.thread, .advanced)") ? within.parentElement : within;
  let isFolded = false;
  while ((at = at?.closest("details") ?? null) instanceof HTMLDetailsElement) {
    isFolded ||= !at.open;
    at.open = true;
    at = at.parentElement;
  }
  if (isFolded) named?.scrollIntoView({ block: "center" });
}

addEventListener("hashchange", takeUp);
if (find('[data-code="made"]', HTMLElement)) find("#reason", HTMLTextAreaElement)?.focus({ preventScroll: true }); // a set was made just now: its reason is typed next

for (const dialog of findAll("dialog.act-dialog[open]", HTMLDialogElement)) {
  dialog.close();
  open(dialog);
}
takeUp();
