// Set the theme before the first paint, and change it from the button in the top bar. The choice stays in this browser;
// as long as there is none, whoever asks the system for more contrast gets it. Paper is a theme of the figures, too.
(() => {
  const NAMES = { dark: "dark", light: "light", contrast: "high contrast" };
  const order = Object.keys(NAMES);
  const root = document.documentElement;
  const more = matchMedia("(prefers-contrast: more)");
  const chosen = () => order.find((theme) => theme === localStorage.getItem("boresight-theme")) ?? (more.matches ? "contrast" : "dark");
  const following = () => order[(order.indexOf(root.dataset.theme) + 1) % order.length];
  const show = () => {
    root.dataset.theme = chosen();
    const button = document.getElementById("theme");
    if (button) button.ariaLabel = button.title = `Theme: ${NAMES[root.dataset.theme]}. Change to ${NAMES[following()]}`;
    document.dispatchEvent(new CustomEvent("boresight:theme", { detail: root.dataset.theme }));
  };
  show();
  for (const asked of [more, matchMedia("print")]) asked.addEventListener("change", show);
  document.addEventListener("DOMContentLoaded", () => {
    show();
    document.getElementById("theme")?.addEventListener("click", () => {
      localStorage.setItem("boresight-theme", following());
      show();
    });
  });
})();
