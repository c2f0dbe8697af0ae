/**
 * <frame-browser>: the frame part of a run page, quicker than by whole pages; without it every control works by loading.
 *
 * Links to frames and the form fetch the page and renew this part alone; the address follows, so Back works. The scale of the
 * residuals changes on the spot. A star under the pointer, or whose row is, is marked in both drawing and table.
 */
const NOT_ABOVE = 1 + 1e-9;
const BAR_SHARE = 0.1; // as pages/frame_drawing.py

/** 1, 2 or 5 times a power of ten, not above a value. */
function roundDown(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Math.max(...[1, 2, 5].map((step) => step * power).filter((step) => step <= value * NOT_ABOVE));
}

function withScale(href, scale) {
  const address = new URL(href);
  address.searchParams.set("scale", scale);
  return address;
}

class FrameBrowser extends HTMLElement {
  #asked = 0;

  connectedCallback() {
    this.addEventListener("click", (event) => this.#follow(event));
    this.addEventListener("submit", (event) => this.#submit(event));
    this.addEventListener("change", (event) => this.#change(event.target));
    this.addEventListener("keydown", (event) => this.#step(event));
    this.addEventListener("pointerover", (event) => this.#mark(event.target.closest("[data-star]")));
    window.addEventListener("popstate", () => this.#load(location.href));
  }

  #follow(event) {
    const link = event.target.closest("a[data-frame-link]");
    if (!link || event.button || event.metaKey || event.ctrlKey || event.shiftKey) return;
    event.preventDefault();
    this.#go(link.href, link.dataset.frameLink);
  }

  #submit(event) {
    event.preventDefault();
    this.#go(`${location.pathname}?${new URLSearchParams(new FormData(event.target))}`);
  }

  #change(control) {
    if (control.matches("[data-frame-scale]")) this.#rescale(Number(control.value));
    else if (control.matches("select")) control.form.requestSubmit();
  }

  #step(event) {
    const relation = { ArrowLeft: "previous", ArrowRight: "next" }[event.key];
    if (!relation || !event.target.matches(".frame-drawing")) return;
    event.preventDefault();
    this.querySelector(`[data-frame-link=${relation}]`)?.click();
  }

  async #go(href, relation) {
    const drawn = document.activeElement?.matches(".frame-drawing");
    if (!(await this.#load(href))) return;
    history.pushState(null, "", href);
    const place = drawn ? ".frame-drawing" : relation ? `[data-frame-link=${relation}]` : "h2";
    this.querySelector(place)?.focus({ preventScroll: true });
  }

  /** Renew this part from the page at an address; the newest request wins, and one that fails is opened as a page. */
  async #load(href) {
    const asked = (this.#asked += 1);
    this.setAttribute("aria-busy", "true");
    const answer = await fetch(href).catch(() => null);
    const fresh = answer?.ok && new DOMParser().parseFromString(await answer.text(), "text/html").getElementById(this.id);
    if (asked !== this.#asked) return false;
    if (!fresh) return location.assign(href);
    this.removeAttribute("aria-busy");
    this.replaceChildren(...fresh.childNodes);
    return true;
  }

  #rescale(scale) {
    const drawing = this.querySelector(".frame-drawing");
    for (const line of drawing.querySelectorAll("line[data-dx]")) {
      line.setAttribute("x2", Number(line.getAttribute("x1")) + line.dataset.dx * scale);
      line.setAttribute("y2", Number(line.getAttribute("y1")) + line.dataset.dy * scale);
    }
    for (const circle of drawing.querySelectorAll("circle[data-r]")) circle.setAttribute("r", circle.dataset.r * scale);
    const bar = drawing.querySelector(".bar");
    const px = roundDown((BAR_SHARE * bar.dataset.width) / scale);
    bar.querySelector("line").setAttribute("x2", px * scale);
    bar.querySelector("text").textContent = `${Number(px.toPrecision(3))} px of residual`;
    this.querySelector("[data-scale-words]").textContent = scale;
    for (const link of this.querySelectorAll("[data-frame-link]")) link.href = withScale(link.href, scale);
    history.replaceState(null, "", withScale(location.href, scale));
  }

  #mark(star) {
    for (const shown of this.querySelectorAll(".is-shown")) shown.classList.remove("is-shown");
    for (const same of star ? this.querySelectorAll(`[data-star="${star.dataset.star}"]`) : []) same.classList.add("is-shown");
  }
}

customElements.define("frame-browser", FrameBrowser);
