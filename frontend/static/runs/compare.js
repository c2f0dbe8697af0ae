/** The comparison: changing the reference or a view option changes the address, and every figure shows one cursor. */

for (const form of document.querySelectorAll("form[data-submit-on-change]")) {
  form.addEventListener("change", () => form.requestSubmit());
}
