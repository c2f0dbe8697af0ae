// Set the theme before the first paint, and change it from the button in the top bar. The choice stays in this browser.
(() => {
  const root = document.documentElement;
  const chosen = localStorage.getItem("boresight-theme");
  root.dataset.theme = chosen ?? "dark";
  document.addEventListener("DOMContentLoaded", () => {
    document.getElementById("theme")?.addEventListener("click", () => {
      root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
      localStorage.setItem("boresight-theme", root.dataset.theme);
      document.dispatchEvent(new CustomEvent("boresight:theme", { detail: root.dataset.theme }));
    });
  });
})();
