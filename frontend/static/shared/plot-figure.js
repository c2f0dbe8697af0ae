/**
 * <plot-figure src name label scale>: one Plotly figure of a run, fetched as JSON and drawn as SVG.
 *
 * States, each in words below the drawing: loading, empty, error (with Retry), stale (the last good drawing stays,
 * dimmed, with its time). A `figure-refresh` event on the element fetches again, and the link's return what is in error or
 * stale. The panel around it has the CSV link and the PNG button; an image is always on white. `scale` is log or linear, for
 * the axes that a figure offers both for. Of a figure that was thinned (`meta.detail`) a zoomed window is asked for again, in
 * full. Charts of one axis share a cursor.
 * A `small` one fills its place, and its panel's link opens the large one. What is folded away is drawn when it is unfolded.
 * The figure of a running run says as of which frame it is (`meta.as_of`). What is zoomed stands in the address (view-address.js).
 */
import { makeAge } from "./clock.js";
import { find, findAll, make } from "./dom.js";
import { count } from "./numbers.js";
import { linkCursor, unlinkCursor } from "./plot-cursor.js";
import { isForPaper, onTheme, onWhite, usePaper } from "./plot-theme.js";
import { clear, draw, fit, makeImage, isDrawn, load, getRange, zoomTo } from "./plotly.js";
import { BACKGROUND, Problem, fetchJson, describeError } from "./requests.js";
import { getZoom, keepZoom } from "./view-address.js";

const SLOW_MS = 10_000;
const SIZES = { narrow: 420, medium: 820 }; // below these, as a phone and as a column of a page, some figures are laid out otherwise
const LOADING = "Loading the figure.";
const NOT_DRAWN = "This figure was not drawn when the page was printed. “Print this page”, at the foot of the page, draws every figure first.";
const PAPER_PX = { small: 330, large: 680 }; // what A4 leaves of a panel's width
const WAIT_MS = 250; // a zoom, or another layout, is asked for when it has come to rest: a picture of a whole page squeezes it for a moment

// Figures in sight are drawn at once, the others when they come near. What nobody scrolled to is drawn for a print or a search
// of the page one after another, with rests, while nobody does anything and nothing was drawn in sight for a while: no drawing
// can be interrupted, and one of 0.3 s would hold up a key
const near = new IntersectionObserver(
  (entries) => {
    for (const { isIntersecting, target } of entries) if (isIntersecting && target instanceof PlotFigure) target.begin().then(noteBusy);
  },
  { rootMargin: "100px" },
);
const QUIET_MS = 5000;
let busyAt = performance.now();
const noteBusy = () => void (busyAt = performance.now());
for (const act of ["keydown", "pointerdown", "wheel", "scroll"]) addEventListener(act, noteBusy, { capture: true, passive: true });
async function waitForQuiet() {
  for (let left = QUIET_MS; left > 0; left = busyAt + QUIET_MS - performance.now()) await pause(left);
  await new Promise((resolve) => requestIdleCallback(resolve));
}
const REST = 2; // times as long as the drawing took
/** @param {number} ms */
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
/** @type {Promise<unknown>} */
let queue = Promise.resolve();

/** @param {Column | undefined} values */
const length = (values) => (values && "bdata" in values ? values.bdata : values)?.length ?? 0;
/** @param {Figure} figure */
const isEmpty = (figure) => !figure.data.some(({ x, y, z }) => [x, y, z].some((values) => length(values) > 0));
/** @param {Figure} figure */
const getReason = (figure) => figure.layout.annotations?.[0]?.text ?? "No data yet: the run has not reached this stage.";
/** @param {string | undefined} markup */
const plain = (markup) => new DOMParser().parseFromString(markup ?? "", "text/html").body.textContent;
const utcTime = () => `${new Date().toISOString().slice(11, 19)}Z`;

/**
 * The window that a change of the axes zoomed to; null where it shows all again, undefined where no x axis moved.
 * @param {ZoomChange} change
 * @returns {[number, number] | null | undefined}
 */
function readWindow(change) {
  const axis = Object.keys(change).find((name) => /^xaxis\d*\.(range\[0\]|range|autorange)$/.test(name))?.split(".")[0];
  if (!axis) return undefined;
  const [from, to] = [change[`${axis}.range[0]`], change[`${axis}.range[1]`]];
  return typeof from === "number" && typeof to === "number" ? [from, to] : change[`${axis}.autorange`] || change[`${axis}.range`] ? null : undefined;
}

/** Whether an axis shows a window. @param {[number, number] | undefined} range @param {[number, number]} window */
const shows = (range, [from, to]) => range !== undefined && Math.abs(range[0] - from) + Math.abs(range[1] - to) < 1e-6 * Math.abs(to - from);

export class PlotFigure extends HTMLElement {
  #begun = false;
  /** @type {Figure | null} */
  #figure = null;
  #busy = false;
  /** @type {Promise<void> | null} what is fetched and drawn now */
  #work = null;
  #again = false;
  #drawnAt = "";
  #abort = new AbortController();
  /** @type {[number, number] | null} the part of the one axis of all panels that is looked at */
  #window = null;
  #zoomTimer = 0;
  #layoutTimer = 0;
  #costMs = 0;
  #paper = false;
  #form = "";
  /** @type {Canvas} */
  canvas = make("div", { className: "figure-canvas", role: "img" });
  #words = make("p", { className: "figure-words", role: "status" });
  #retry = make("button", { type: "button", className: "button-small", textContent: "Retry", hidden: true });
  #headline = make("p", { className: "figure-headline", hidden: true });
  #asOf = make("p", { className: "figure-as-of", hidden: true });
  /** @type {HTMLButtonElement | null} */
  #png = null;
  #resizer = new ResizeObserver(() => this.#resize());

  connectedCallback() {
    if (!this.canvas.isConnected) this.#build();
    this.#abort = new AbortController();
    const { signal } = this.#abort;
    this.addEventListener("figure-refresh", () => this.refresh(BACKGROUND), { signal });
    document.addEventListener("boresight:theme", () => this.#draw(), { signal });
    document.addEventListener("boresight:link", ({ detail }) => {
      if (detail.state === "live" && ["error", "stale"].includes(this.dataset.state ?? "")) this.refresh(BACKGROUND);
    }, { signal });
    addEventListener("hashchange", () => this.#zoom(), { signal });
    this.#resizer.observe(this.canvas);
    this.#say("loading", LOADING);
    near.observe(this);
    queue = queue.then(waitForQuiet).then(() => this.#drawInTurn());
  }

  async #drawInTurn() {
    if (this.#begun) return;
    await this.begin();
    await pause(REST * this.#costMs);
  }

  /** Fetch and draw for the first time, unless that was done already, or wait for it where it is under way. */
  async begin() {
    if (this.checkVisibility()) near.unobserve(this);
    await (!this.#begun && this.isConnected && this.checkVisibility() ? this.refresh() : this.#work);
  }

  disconnectedCallback() {
    near.unobserve(this);
    this.#begun = false;
    this.#abort.abort();
    this.#resizer.disconnect();
    unlinkCursor(this.canvas);
    clear(this.canvas);
  }

  #build() {
    this.canvas.ariaLabel = this.isSmall ? this.getAttribute("label") : `${this.getAttribute("label")}. The table below has the same data.`;
    if (!this.isSmall) this.canvas.tabIndex = 0;
    this.#retry.addEventListener("click", () => this.refresh());
    this.prepend(this.#headline, this.#asOf, this.canvas, this.#words, this.#retry);
    const panel = this.closest(".figure-panel");
    this.#png = panel && find("[data-png]", HTMLButtonElement, panel);
    this.#png?.addEventListener("click", () => this.#savePng());
    if (this.#png) this.#png.disabled = true;
  }

  /** Fetch and draw; a refresh that arrives in the middle of one is done once, afterwards. @param {Record<string, string>} [headers] */
  refresh(headers = {}) {
    if (this.#busy) this.#again = true;
    else this.#work = this.#fetchAndDraw(headers);
    return this.#work;
  }

  /** @param {Record<string, string>} headers */
  async #fetchAndDraw(headers) {
    this.#begun = this.#busy = true;
    const slow = setTimeout(() => this.#say("loading", "Still working on this figure."), SLOW_MS);
    if (!this.#figure) this.#say("loading", LOADING);
    try {
      const [figure] = await Promise.all([fetchJson(this.#address(this.#window), headers), load()]);
      this.#figure = figure;
      this.#drawnAt = utcTime();
      await this.#draw();
    } catch (error) {
      this.#fail(error);
    } finally {
      clearTimeout(slow);
      this.#busy = false;
    }
    if (this.#again && this.isConnected) {
      this.#again = false;
      this.refresh(headers);
    }
  }

  async #draw() {
    const figure = this.#figure;
    if (!figure || !this.isConnected) return;
    if (isEmpty(figure)) {
      this.#say("empty", getReason(figure));
      return;
    }
    this.#say("ready", "");
    const { data, layout } = this.#scaled(onTheme(figure));
    const isFirst = !isDrawn(this.canvas);
    const began = performance.now();
    await draw(this.canvas, { data, layout: { ...layout, ...this.#size() } });
    this.#costMs = performance.now() - began;
    if (isFirst && !this.isSmall) {
      this.canvas.on?.("plotly_relayout", (change) => {
        keepZoom(this.#name, change);
        this.#look(change);
      });
      if (getZoom(this.#name).size) await this.#zoom();
    }
    if (!this.isSmall) linkCursor(this.canvas, layout.meta?.axis);
    this.tellPlace(figure.layout.meta?.as_of);
    this.#headline.textContent = plain(figure.layout.title?.text);
    this.#headline.hidden = !this.#headline.textContent || this.#headline.textContent === this.getAttribute("label");
    if (this.isSmall) this.#headline.hidden = true;
    if (this.#png) this.#png.disabled = false;
    this.dispatchEvent(new CustomEvent("figure-drawn", { bubbles: true }));
  }

  /**
   * Draw for paper, or again for the screen, before the browser lays the page out. It waits for no fetch, so a figure that was not
   * drawn says so on paper.
   * @param {boolean} paper
   */
  print(paper) {
    this.#paper = paper;
    if (!this.checkVisibility()) return undefined;
    if (isDrawn(this.canvas)) return this.#draw();
    if (this.dataset.state === "loading") {
      this.begin();
      this.#say("loading", paper ? NOT_DRAWN : LOADING);
    }
    return undefined;
  }

  /** Draw for paper, after the first drawing where there was none, unless the page was printed without it meanwhile. */
  async prepareForPaper() {
    await this.begin();
    if (isForPaper()) await this.print(true);
  }

  /** Show what the address says of this chart. */
  async #zoom() {
    if (!this.isSmall && isDrawn(this.canvas)) await zoomTo(this.canvas, getZoom(this.#name));
  }

  get #name() {
    return this.getAttribute("name") ?? "";
  }

  get isSmall() {
    return this.hasAttribute("small");
  }

  /** Say as of which step of a running run the drawing is, of how many, and how old that is; of one that has ended nothing. @param {Place} [place] */
  tellPlace(place) {
    this.#asOf.hidden = !place;
    if (!place) return;
    const { axis, step, of, at_utc: at } = place;
    this.#asOf.replaceChildren(`As of ${axis} ${count(step)}${of && step <= of ? ` of ${count(of)}` : ""}`, ...(at ? [", ", makeAge(at)] : []));
  }

  /** Say the same of a newer step. @param {number} step @param {string} at */
  movePlace(step, at) {
    const place = this.#figure?.layout.meta?.as_of;
    if (place) this.tellPlace({ ...place, step, at_utc: at });
  }

  /** The figure's address, with the window that is looked at. @param {[number, number] | null} window */
  #address(window) {
    const address = new URL(this.getAttribute("src") ?? "", location.href);
    this.#form = this.#wantedForm;
    if (this.#form) address.searchParams.set("size", this.#form);
    for (const [place, name] of ["x_from", "x_to"].entries()) if (window) address.searchParams.set(name, String(window[place]));
    return address.pathname + address.search;
  }

  /** Put the axes that are offered on both scales on the one that is asked for. @param {Figure} figure */
  #scaled({ data, layout }) {
    const type = this.getAttribute("scale");
    for (const axis of (type && layout.meta?.log) || []) layout[axis] = { ...layout[axis], type: type ?? "", autorange: true };
    return { data, layout };
  }

  /**
   * After a zoom ask for what was thinned away there: where every panel shows the same part of one axis for the whole figure,
   * else for the curves of the panels that show it.
   * @param {ZoomChange} change
   */
  #look(change) {
    const window = readWindow(change);
    const layout = this.#figure?.layout;
    if (window === undefined || !layout?.meta?.detail) return;
    const isOneAxis = Object.entries(layout).every(([name, axis]) => !/^xaxis\d+$/.test(name) || axis.matches);
    if (isOneAxis) {
      this.#window = window;
      this.refresh();
    } else {
      clearTimeout(this.#zoomTimer);
      this.#zoomTimer = setTimeout(() => this.#detail(window).catch(() => {}), WAIT_MS); // without detail the drawing stays
    }
  }

  /** @param {[number, number] | null} window */
  async #detail(window) {
    /** @type {Figure} */
    const fresh = await fetchJson(this.#address(window));
    if (!this.#figure) return;
    /** @param {Trace} trace */
    const isShown = ({ xaxis = "x" }) => !window || shows(getRange(this.canvas, `xaxis${xaxis.slice(1)}`), window);
    this.#figure = { ...this.#figure, data: this.#figure.data.map((trace, i) => (isShown(trace) ? fresh.data[i] ?? trace : trace)) };
    await this.#draw();
  }

  #size() {
    const own = Number(this.getAttribute("height")) || this.#figure?.layout.height || 380;
    const height = this.isSmall ? Math.max(120, this.canvas.clientHeight) : own;
    const width = this.#paper ? PAPER_PX[this.isSmall ? "small" : "large"] : Math.max(260, this.canvas.clientWidth);
    return { width, height, autosize: false };
  }

  /** The form for the width that there is, empty for a page's. */
  get #wantedForm() {
    const width = this.canvas.clientWidth || this.clientWidth; // a canvas without a drawing may be hidden
    return this.isSmall ? "" : Object.entries(SIZES).find(([, below]) => width < below)?.[0] ?? "";
  }

  /** Fit the drawing to its place; where that came to rest at another size, as by turning a phone, it is laid out again. */
  #resize() {
    if (!isDrawn(this.canvas) || !this.#figure || !this.canvas.clientWidth) return;
    fit(this.canvas, this.#size());
    clearTimeout(this.#layoutTimer);
    this.#layoutTimer = setTimeout(() => this.#layOut(), WAIT_MS);
  }

  #layOut() {
    if (this.isConnected && !matchMedia("print").matches && this.#wantedForm !== this.#form) this.refresh(BACKGROUND);
  }

  /** @param {unknown} error */
  #fail(error) {
    const sentence = describeError(error);
    if (this.#figure && isDrawn(this.canvas)) {
      this.#say("stale", `STALE: drawn at ${this.#drawnAt}; the refresh failed. ${sentence}`);
    } else {
      this.#say(error instanceof Problem && [404, 409].includes(error.status) ? "empty" : "error", sentence);
    }
    this.#retry.hidden = false;
  }

  /** @param {"loading" | "empty" | "error" | "stale" | "ready"} state @param {string} words */
  #say(state, words) {
    this.dataset.state = state;
    this.canvas.hidden = state === "empty" || state === "error";
    this.#words.textContent = words;
    this.#words.hidden = !words;
    this.#retry.hidden = state !== "error" && state !== "stale";
  }

  async #savePng() {
    if (!this.#figure) return;
    const href = await makeImage(this.#scaled(onWhite(this.#figure)), this.#size().height);
    make("a", { href, download: `${this.getAttribute("name")}.png` }).click();
  }
}

customElements.define("plot-figure", PlotFigure);
document.addEventListener("boresight:print", (event) => {
  if (!(event instanceof CustomEvent)) return;
  usePaper(true);
  event.detail.push(...findAll("plot-figure", PlotFigure).map((figure) => figure.prepareForPaper()));
});
for (const [name, paper] of /** @type {const} */ ([["beforeprint", true], ["afterprint", false]])) {
  addEventListener(name, () => {
    usePaper(paper);
    for (const figure of findAll("plot-figure", PlotFigure)) figure.print(paper);
  });
}
