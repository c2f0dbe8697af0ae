/**
 * <plot-figure src name label scale>: one Plotly figure of a run, fetched as JSON and drawn as SVG.
 *
 * States, each in words below the drawing: loading, empty, error (with Retry), stale (the last good drawing stays,
 * dimmed, with its time). A `figure-refresh` event on the element fetches again. The panel around it has the CSV link and
 * the PNG button; an image is always on white. `scale` is log or linear, for the axes that a figure offers both for. Of a
 * figure that was thinned (`meta.detail`) a zoomed window is asked for again, in full. Charts of one axis share a cursor.
 */
import { linkCursor, unlinkCursor } from "./plot-cursor.js";
import { BACKGROUND, fetchJson } from "./problem.js";
import { onTheme, onWhite } from "./plot-theme.js";

const PLOTLY = "/static/plotly.min.js";
// Plotly writes its maps' style sheet into the page unless this is there; no figure is a map, and the policy refuses it
const MAP_STYLE = "9f215cf04c5486422605d13261cb87401f4e7763b6296af81e98efbc0130da53";
const SLOW_MS = 10_000;
const CONFIG = { displaylogo: false, displayModeBar: false, responsive: false, scrollZoom: false };
let library = null;

/** Load Plotly once for the whole page, when the first figure needs it. */
function plotly() {
  library ??= new Promise((resolve, reject) => {
    if (window.Plotly) return resolve(window.Plotly);
    const script = Object.assign(document.createElement("script"), { src: PLOTLY, async: true });
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => {
      library = null;
      script.remove();
      reject(new Error("The drawing library did not load. Check the connection, then press Retry."));
    };
    document.head.append(Object.assign(document.createElement("meta"), { id: MAP_STYLE }), script);
  });
  return library;
}

// Figures near the window are drawn at once; the others one after another whenever the browser has nothing better to do
const near = new IntersectionObserver(
  (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => entry.target.begin()),
  { rootMargin: "300px" },
);
const idle = () => new Promise((resolve) => (window.requestIdleCallback ? requestIdleCallback(resolve, { timeout: 1500 }) : setTimeout(resolve, 200)));
let queue = Promise.resolve();

const isEmpty = (figure) => !figure.data.some((trace) => ["x", "y", "z"].some((axis) => length(trace[axis]) > 0));
const length = (values) => values?.length ?? (values?.bdata ? values.bdata.length : 0);
const reasonOf = (figure) => figure.layout?.annotations?.[0]?.text ?? "Nothing to draw yet: the run has not come this far.";
const plain = (markup) => new DOMParser().parseFromString(markup ?? "", "text/html").body.textContent;
const utcTime = () => `${new Date().toISOString().slice(11, 19)}Z`;

class PlotFigure extends HTMLElement {
  #begun = false;
  #figure = null;
  #busy = false;
  #again = false;
  #drawnAt = "";
  #abort = null;
  #window = null;

  connectedCallback() {
    if (!this.canvas) this.#build();
    this.#abort = new AbortController();
    const { signal } = this.#abort;
    this.addEventListener("figure-refresh", () => this.refresh(BACKGROUND), { signal });
    document.addEventListener("boresight:theme", () => this.#draw(), { signal });
    this.resizer = new ResizeObserver(() => this.#resize());
    this.resizer.observe(this.canvas);
    this.#say("loading", "Loading the figure.");
    near.observe(this);
    queue = queue.then(idle).then(() => this.begin());
  }

  /** Fetch and draw for the first time, unless that was done already. */
  async begin() {
    near.unobserve(this);
    if (!this.#begun && this.isConnected) await this.refresh();
  }

  disconnectedCallback() {
    near.unobserve(this);
    this.#begun = false;
    this.#abort.abort();
    this.resizer.disconnect();
    unlinkCursor(this.canvas);
    if (this.canvas._fullLayout) window.Plotly.purge(this.canvas);
  }

  #build() {
    this.canvas = document.createElement("div");
    this.canvas.className = "figure-canvas";
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${this.getAttribute("label")}. The table below has the same data.`);
    this.words = Object.assign(document.createElement("p"), { className: "figure-words" });
    this.words.setAttribute("role", "status");
    this.retry = Object.assign(document.createElement("button"), { type: "button", className: "button-small", textContent: "Retry", hidden: true });
    this.retry.addEventListener("click", () => this.refresh());
    this.headline = Object.assign(document.createElement("p"), { className: "figure-headline", hidden: true });
    this.prepend(this.headline, this.canvas, this.words, this.retry);
    this.png = this.closest(".figure-panel")?.querySelector("[data-png]");
    this.png?.addEventListener("click", () => this.#savePng());
    if (this.png) this.png.disabled = true;
  }

  /** Fetch and draw; a refresh that arrives in the middle of one is done once, afterwards. */
  async refresh(headers = {}) {
    if (this.#busy) {
      this.#again = true;
      return;
    }
    this.#begun = this.#busy = true;
    const slow = setTimeout(() => this.#say("loading", "Still working on this figure."), SLOW_MS);
    if (!this.#figure) this.#say("loading", "Loading the figure.");
    try {
      const [figure] = await Promise.all([fetchJson(this.#address(), { headers }), plotly()]);
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
    if (!this.#figure || !window.Plotly || !this.isConnected) return;
    if (isEmpty(this.#figure)) {
      this.#say("empty", reasonOf(this.#figure));
      return;
    }
    this.#say("ready", "");
    const { data, layout } = this.#scaled(onTheme(this.#figure));
    const first = !this.canvas._fullLayout;
    await window.Plotly.react(this.canvas, data, { ...layout, ...this.#size() }, CONFIG);
    if (first) this.canvas.on("plotly_relayout", (change) => this.#look(change));
    linkCursor(this.canvas, layout.meta?.axis);
    this.headline.textContent = plain(this.#figure.layout.title?.text);
    this.headline.hidden = !this.headline.textContent || this.headline.textContent === this.getAttribute("label");
    if (this.png) this.png.disabled = false;
    this.dispatchEvent(new CustomEvent("figure-drawn", { bubbles: true }));
  }

  /** The figure's address, with the window that is looked at. */
  #address() {
    const address = new URL(this.getAttribute("src"), location);
    this.#window?.forEach((end, place) => address.searchParams.set(["x_from", "x_to"][place], end));
    return address.pathname + address.search;
  }

  /** Put the axes that are offered on both scales on the one that is asked for. */
  #scaled({ data, layout }) {
    const type = this.getAttribute("scale");
    for (const axis of (type && layout.meta?.log) || []) Object.assign(layout[axis], { type, autorange: true });
    return { data, layout };
  }

  /** After a zoom ask for what was thinned away there; only where every panel shows the same part of one axis. */
  #look(change) {
    const { layout } = this.#figure;
    const axes = Object.keys(layout).filter((name) => name.startsWith("xaxis"));
    if (!layout.meta?.detail || axes.some((name) => name !== "xaxis" && !layout[name].matches)) return;
    const ends = [0, 1].map((end) => Object.entries(change).find(([name]) => name.startsWith("xaxis") && name.endsWith(`[${end}]`))?.[1]);
    const whole = Object.keys(change).some((name) => name.startsWith("xaxis") && name.endsWith(".autorange"));
    if (!whole && !ends.every(Number.isFinite)) return;
    this.#window = whole ? null : ends;
    this.refresh();
  }

  #size() {
    const height = Number(this.getAttribute("height")) || this.#figure.layout?.height || 380;
    return { width: Math.max(260, this.canvas.clientWidth), height, autosize: false };
  }

  #resize() {
    if (!this.canvas._fullLayout || !this.#figure) return;
    const size = this.#size();
    if (size.width !== this.canvas._fullLayout.width) window.Plotly.relayout(this.canvas, size);
  }

  #fail(error) {
    if (this.#figure && this.canvas._fullLayout) {
      this.#say("stale", `STALE: drawn at ${this.#drawnAt}; the refresh failed. ${error.message}`);
    } else {
      this.#say(error.status === 404 || error.status === 409 ? "empty" : "error", error.message);
    }
    this.retry.hidden = false;
  }

  #say(state, words) {
    this.dataset.state = state;
    this.canvas.hidden = state === "empty" || state === "error";
    this.words.textContent = words;
    this.words.hidden = !words;
    this.retry.hidden = state !== "error" && state !== "stale";
  }

  async #savePng() {
    const { data, layout } = this.#scaled(onWhite(this.#figure));
    const { height } = this.#size();
    const url = await window.Plotly.toImage({ data, layout }, { format: "png", width: 1200, height, scale: 2 });
    Object.assign(document.createElement("a"), { href: url, download: `${this.getAttribute("name")}.png` }).click();
  }
}

customElements.define("plot-figure", PlotFigure);
