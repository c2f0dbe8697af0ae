// A chosen text file is shown in the text field named by its data-into, so that it can be read and corrected before it is sent.

for (const input of document.querySelectorAll("input[type=file][data-into]")) {
  const target = document.getElementById(input.dataset.into);
  input.addEventListener("change", async () => {
    if (!input.files.length) return;
    target.value = await input.files[0].text();
    input.value = "";
    target.focus();
  });
}
