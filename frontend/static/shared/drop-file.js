/** What file fields do beyond choosing. */
import { find, findAll } from "./dom.js";

// A chosen text file is shown in the text field named by its data-into, so that it can be read and corrected before it is sent.
for (const input of findAll("input[type=file][data-into]", HTMLInputElement)) {
  const target = find(`#${input.dataset.into}`, HTMLTextAreaElement);
  input.addEventListener("change", async () => {
    const file = input.files?.[0];
    if (!file || !target) return;
    target.value = await file.text();
    input.value = "";
    target.focus();
  });
}

// A file can be dropped anywhere on the place that holds its field.
for (const place of findAll(".drop", HTMLElement)) {
  const input = find("input[type=file]", HTMLInputElement, place);
  /** @param {DragEvent} event */
  const mark = (event, over = true) => {
    event.preventDefault();
    place.classList.toggle("over", over);
  };
  place.addEventListener("dragover", (event) => mark(event));
  place.addEventListener("dragleave", (event) => mark(event, false));
  place.addEventListener("drop", (event) => {
    mark(event, false);
    const files = event.dataTransfer?.files;
    if (!input || !files?.length) return;
    input.files = files;
    input.dispatchEvent(new Event("change", { bubbles: true })); // as when it is chosen
  });
}
