// Takes "Skip to content" to the content by itself. As a plain link it would change the address, and a browser that is
// still loading the page goes to the fragment of its address once more at the end: whoever had stepped on was thrown back.
document.addEventListener("click", (event) => {
  if (!event.target.closest?.("a.skip")) return;
  event.preventDefault();
  const content = document.getElementById("content");
  content.focus({ preventScroll: true });
  scrollTo(0, 0);
});
