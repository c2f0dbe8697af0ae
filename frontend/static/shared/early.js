// What must stand before the first paint: the theme, and the link that skips to the content.
//
// The theme is changed by the button in the top bar. A person's choice is kept on the server, which tells it by a cookie at the next
// log-in; before that it stays in this browser. As long as there is none it is the system's: more contrast where that is asked for,
// else light or dark. Paper is a theme of the figures, too.
{
  /** @type {Record<string, string>} */
  const NAMES = { dark: "dark", light: "light", contrast: "high contrast" };
  const order = Object.keys(NAMES);
  const root = document.documentElement;
  const more = matchMedia("(prefers-contrast: more)");
  const light = matchMedia("(prefers-color-scheme: light)");
  const STORED = "boresight-theme";
  const told = () => document.cookie.split("; ").find((one) => one.startsWith(`${STORED}=`))?.slice(STORED.length + 1);
  const chosen = () =>
    order.find((theme) => theme === (told() ?? localStorage.getItem(STORED))) ?? (more.matches ? "contrast" : light.matches ? "light" : "dark");
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
      const theme = following();
      localStorage.setItem(STORED, theme);
      if (told() !== undefined) document.cookie = `${STORED}=${theme}; path=/; max-age=31536000; samesite=lax`;
      show();
      const token = document.querySelector("input[name=csrf_token]");
      if (token instanceof HTMLInputElement && document.querySelector("nav.side")) {
        const headers = { "Content-Type": "application/json", "X-CSRF-Token": token.value };
        fetch("/api/v1/preferences/theme:set", { method: "POST", headers, body: JSON.stringify({ value: theme }), keepalive: true }).catch(() => {});
      }
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
