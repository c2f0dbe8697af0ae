// What must stand before the first paint: the theme, and the link that skips to the content.
//
// The theme is changed by the button in the top bar. The choice stays in this browser; as long as there is none it is the system's:
// more contrast where that is asked for, else light or dark. Paper is a theme of the figures, too.
{
  /** @type {Record<string, string>} */
  const NAMES = { dark: "dark", light: "light", contrast: "high contrast" };
  const order = Object.keys(NAMES);
  const root = document.documentElement;
  const more = matchMedia("(prefers-contrast: more)");
  const light = matchMedia("(prefers-color-scheme: light)");
  const chosen = () =>
    order.find((theme) => theme === localStorage.getItem("boresight-theme")) ?? (more.matches ? "contrast" : light.matches ? "light" : "dark");
  const following = () => order[(order.indexOf(root.dataset.theme ?? "") + 1) % order.length] ?? "";
  const show = () => {
    const theme = (root.dataset.theme = chosen());
    const button = document.getElementById("theme");
    if (button) button.ariaLabel = button.title = `Theme: ${NAMES[theme]}. Change to ${NAMES[following()]}`;
    document.dispatchEvent(new CustomEvent("boresight:theme", { detail: theme }));
  };
  show();
  for (const asked of [more, light, matchMedia("print")]) asked.addEventListener("change", show);
  document.addEventListener("DOMContentLoaded", () => {
    show();
    document.getElementById("theme")?.addEventListener("click", () => {
      localStorage.setItem("boresight-theme", following());
      show();
    });
  });

  // As a plain link it would change the address, and a browser that is still loading the page goes to the fragment of its
  // address once more at the end: whoever had stepped on was thrown back.
  document.addEventListener("click", (event) => {
    if (!(event.target instanceof Element) || !event.target.closest("a.skip")) return;
    event.preventDefault();
    document.getElementById("content")?.focus({ preventScroll: true });
    scrollTo(0, 0);
  });
}
