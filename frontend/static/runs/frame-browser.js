/**
 * <frame-browser>: the frame part of a run page, quicker than by whole pages; without it every control works by loading.
 *
 * Links to frames and the form fetch the page and renew this part alone; the address follows, so Back works. The scale of the
 * residuals changes on the spot. A star under the pointer, or whose row is, is marked in both drawing and table.
 */
import { around, find, findAll, need } from "../shared/dom.js";
import { parsePage } from "../shared/requests.js";

const NOT_ABOVE = 1 + 1e-9;
const BAR_SHARE = 0.1; // as the drawing is made on the server

/** 1, 2 or 5 times a power of ten, not above a value. @param {number} value */
function roundDown(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Math.max(...[1, 2, 5].map((step) => step * power).filter((step) => step <= value * NOT_ABOVE));
}

/** @param {string} href @param {number} scale */
function withScale(href, scale) {
  const address = new URL(href);
  address.searchParams.set("scale", String(scale));
  return address;
}

class FrameBrowser extends HTMLElement {
  #asked = 0;

  connectedCallback() {
    this.addEventListener("click", (event) => this.#follow(event));
    this.addEventListener("submit", (event) => this.#submit(event));
    this.addEventListener("change", ({ target }) => target instanceof HTMLSelectElement && this.#change(target));
    this.addEventListener("keydown", (event) => this.#step(event));
    this.addEventListener("pointerover", (event) => this.#mark(around(event, "[data-star]")));
    window.addEventListener("popstate", () => this.#load(location.href));
  }

  /** @param {MouseEvent} event */
  #follow(event) {
    const link = around(event, "a[data-frame-link]");
    if (!(link instanceof HTMLAnchorElement) || event.button || event.metaKey || event.ctrlKey || event.shiftKey) return;
    event.preventDefault();
    this.#go(link.href, link.dataset.frameLink);
  }

  /** @param {SubmitEvent} event */
  #submit(event) {
    if (!(event.target instanceof HTMLFormElement)) return;
    event.preventDefault();
    const query = new URLSearchParams();
    for (const [name, value] of new FormData(event.target)) query.append(name, String(value));
    this.#go(`${location.pathname}?${query}`);
  }

  /** @param {HTMLSelectElement} control */
  #change(control) {
    if (control.matches("[data-frame-scale]")) this.#rescale(Number(control.value));
    else control.form?.requestSubmit();
  }

  /** @param {KeyboardEvent} event */
  #step(event) {
    const relation = event.key === "ArrowLeft" ? "previous" : event.key === "ArrowRight" ? "next" : null;
    if (!relation || !(event.target instanceof Element) || !event.target.matches(".frame-drawing")) return;
    event.preventDefault();
    find(`[data-frame-link=${relation}]`, HTMLAnchorElement, this)?.click();
  }

  /** @param {string} href @param {string} [relation] */
  async #go(href, relation) {
    const drawn = document.activeElement?.matches(".frame-drawing");
    if (!(await this.#load(href))) return;
    history.pushState(null, "", href);
    const place = this.querySelector(drawn ? ".frame-drawing" : relation ? `[data-frame-link=${relation}]` : "h2");
    if (place instanceof HTMLElement || place instanceof SVGElement) place.focus({ preventScroll: true });
  }

  /** Renew this part from the page at an address; the newest request wins, and one that fails is opened as a page. @param {string} href */
  async #load(href) {
    const asked = (this.#asked += 1);
    this.setAttribute("aria-busy", "true");
    const answer = await fetch(href).catch(() => null);
    const fresh = answer?.ok ? (await parsePage(answer)).getElementById(this.id) : null;
    if (asked !== this.#asked) return false;
    if (!fresh) {
      location.assign(href);
      return false;
    }
    this.removeAttribute("aria-busy");
    this.replaceChildren(...fresh.childNodes);
    return true;
  }

  /** @param {number} scale */
  #rescale(scale) {
    const drawing = need(".frame-drawing", SVGElement, this);
    for (const line of findAll("line[data-dx]", SVGLineElement, drawing)) {
      line.setAttribute("x2", String(line.x1.baseVal.value + Number(line.dataset.dx) * scale));
      line.setAttribute("y2", String(line.y1.baseVal.value + Number(line.dataset.dy) * scale));
    }
    for (const circle of findAll("circle[data-r]", SVGCircleElement, drawing)) circle.setAttribute("r", String(Number(circle.dataset.r) * scale));
    const bar = need(".bar", SVGElement, drawing);
    const px = roundDown((BAR_SHARE * Number(bar.dataset.width)) / scale);
    need("line", SVGLineElement, bar).setAttribute("x2", String(px * scale));
    need("text", SVGTextElement, bar).textContent = `${Number(px.toPrecision(3))} px of residual`;
    need("[data-scale-words]", HTMLElement, this).textContent = String(scale);
    for (const link of findAll("[data-frame-link]", HTMLAnchorElement, this)) link.href = withScale(link.href, scale).href;
    history.replaceState(null, "", withScale(location.href, scale));
  }

  /** @param {HTMLElement | SVGElement | null} star */
  #mark(star) {
    for (const shown of this.querySelectorAll(".is-shown")) shown.classList.remove("is-shown");
    for (const same of star ? this.querySelectorAll(`[data-star="${star.dataset.star}"]`) : []) same.classList.add("is-shown");
  }
}

customElements.define("frame-browser", FrameBrowser);
