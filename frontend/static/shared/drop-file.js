// What file fields do beyond choosing. A chosen text file is shown in the text field named by its data-into, so that it
// can be read and corrected before it is sent.

for (const input of document.querySelectorAll("input[type=file][data-into]")) {
  const target = document.getElementById(input.dataset.into);
  input.addEventListener("change", async () => {
    if (!input.files.length) return;
    target.value = await input.files[0].text();
    input.value = "";
    target.focus();
  });
}

// A file can be dropped anywhere on the place that holds its field.
for (const place of document.querySelectorAll(".drop")) {
  const input = place.querySelector("input[type=file]");
  const mark = (over) => (event) => {
    event.preventDefault();
    place.classList.toggle("over", over);
  };
  place.addEventListener("dragover", mark(true));
  place.addEventListener("dragleave", mark(false));
  place.addEventListener("drop", (event) => {
    mark(false)(event);
    if (event.dataTransfer.files.length) input.files = event.dataTransfer.files;
  });
}
