// Identifiers and hashes are copied by a click or Enter: every element with data-copy.

function prepare(element) {
  if (element.matches("button")) return; // says itself what it copies
  element.tabIndex = 0;
  element.setAttribute("role", "button");
  element.setAttribute("aria-label", `Copy ${element.dataset.copy}`);
}

async function copy(element) {
  await navigator.clipboard.writeText(element.dataset.copy);
  element.classList.add("copied");
  setTimeout(() => element.classList.remove("copied"), 1200);
}

if (navigator.clipboard) {
  for (const element of document.querySelectorAll("[data-copy]")) prepare(element);
  document.addEventListener("click", (event) => {
    const element = event.target.closest("[data-copy]");
    if (element) copy(element);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && event.target.matches("[data-copy]:not(button)")) copy(event.target);
  });
}
