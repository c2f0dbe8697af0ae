/** <form data-submit-on-change>: a changed choice changes the address. */
import { findAll } from "../shared/dom.js";

for (const form of findAll("form[data-submit-on-change]", HTMLFormElement)) form.addEventListener("change", () => form.requestSubmit());
