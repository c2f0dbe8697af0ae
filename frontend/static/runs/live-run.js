/**
 * <live-run run state>: follows one run while its page is open, from the frame's event stream (link-state.js).
 *
 * Shows progress, pace and the age of the last event; draws the curves on from the points that progress carries
 * (live-history.js) and fetches figures that cannot be drawn on; renews every `[data-live]` part of the page from the
 * server when the run changes state. When the stream opens, and when events were missed, all is fetched again. Drawing takes
 * at most a fifth of the time: a figure out of sight waits until it comes near the window, and all wait as drawing costs.
 */
import { roughSpan } from "../shared/clock.js";
import { find, findAll } from "../shared/dom.js";
import { renewPage } from "../shared/renew-page.js";
import { PlotFigure } from "../shared/plot-figure.js";
import { forget, getNewest, grow, keep } from "./live-history.js";

const TERMINAL = new Set(["SUCCEEDED", "FAILED", "CANCELLED", "LOST"]);
const DRAW_MS = 400;
const REST = 4; // times as long as the last drawing took nothing is drawn
const NEAR = "100px"; // of the window a figure is drawn, as plot-figure.js begins it
const WHOLE_MS = 15_000; // a curve that was drawn on is framed and thinned again after this time, at first sooner
const FETCH_MS = 1000;
const RENEW_MS = 5000;
const SILENT_MS = 30_000;
const following = () => findAll("plot-figure[data-follows]", PlotFigure);
const panel = () => find(".run-live", HTMLElement);
const animationFrame = () => new Promise((resolve) => requestAnimationFrame(resolve));

class LiveRun extends HTMLElement {
  /** @type {string | null} */
  #state = null;
  /** @type {number | undefined} */
  #attempt;
  #isBatch = false;
  #busy = false;
  #wasLink = "";
  #heardAt = NaN;
  #begunAt = 0;
  #wholeAt = 0;
  #drawTimer = 0;
  #restMs = DRAW_MS;
  #fetchTimer = 0;
  /** @type {Set<PlotFigure>} */
  #wanted = new Set();
  /** @type {WeakSet<Element>} to be fetched when they come into sight */
  #late = new WeakSet();
  /** @type {WeakSet<Element>} */
  #near = new WeakSet();
  /** @type {number[]} */
  #timers = [];
  #listening = new AbortController();
  #sight = new IntersectionObserver((entries) => this.#looked(entries), { rootMargin: NEAR });
  #link = new MutationObserver(() => this.#linkChanged());

  connectedCallback() {
    this.#state = this.getAttribute("state");
    if (TERMINAL.has(this.#state ?? "")) return;
    this.#hearServer();
    this.#listening = new AbortController();
    const { signal } = this.#listening;
    document.addEventListener("boresight:progress", ({ detail }) => this.#isMine(detail) && this.#progressed(detail), { signal });
    document.addEventListener("boresight:run", ({ detail }) => this.#isMine(detail) && this.#moved(detail), { signal });
    document.addEventListener("boresight:missed", () => this.#missed(), { signal });
    document.addEventListener("figure-drawn", ({ target }) => target instanceof PlotFigure && this.#near.has(target) && drawOn(target), { signal });
    this.#watch(following());
    this.#link.observe(document.body, { attributes: true, attributeFilter: ["data-link"] });
    // events only say that something moved; the page is asked again from time to time in case one was missed
    this.#timers = [setInterval(() => this.#showAge(), 1000), setInterval(() => this.#renew(), RENEW_MS)];
    this.#showAge();
  }

  disconnectedCallback() {
    this.#rest();
  }

  #rest() {
    this.#listening.abort();
    this.#link.disconnect();
    this.#sight.disconnect();
    for (const timer of this.#timers) clearInterval(timer);
    clearTimeout(this.#drawTimer);
    clearTimeout(this.#fetchTimer);
  }

  /** @param {{ run_id: number }} event */
  #isMine(event) {
    return String(event.run_id) === this.getAttribute("run");
  }

  /** @param {RunProgress} event */
  #progressed(event) {
    this.#heardAt = Date.now();
    if (event.attempt !== this.#attempt) this.#begin(event.attempt);
    this.#isBatch = !event.history && !panel()?.dataset.frames;
    keep(event.history);
    const bar = find("[data-run-progress]", HTMLProgressElement);
    if (bar && Number.isFinite(event.fraction)) {
      bar.value = event.fraction;
      write("percent", `${Math.round(100 * event.fraction)}\u202f%`);
      write("pace", pace(event));
    }
    if (event.message) write("message", event.message);
    this.#showAge();
    this.#planDrawing();
    if (this.#state === "QUEUED" || document.querySelector("#verdict [data-undecided]")) this.#renew();
  }

  /** Another attempt computes: nothing of the one before is drawn on. @param {number} attempt */
  #begin(attempt) {
    this.#attempt = attempt;
    this.#begunAt = Date.now();
    forget();
    this.#fetch(following());
  }

  /** @param {RunEvent} event */
  #moved(event) {
    this.#heardAt = Date.now();
    if (event.state !== this.#state) this.#renew();
  }

  #missed() {
    forget();
    this.#renew();
    this.#fetch(following());
  }

  #linkChanged() {
    const { link = "" } = document.body.dataset;
    if (link === "live" && this.#wasLink !== "live") this.#renew(); // what happened before the stream was open was not heard
    this.#wasLink = link;
    this.#showAge();
  }

  /** @param {PlotFigure[]} figures */
  #watch(figures) {
    for (const figure of figures) this.#sight.observe(figure);
  }

  /** Draw on, or fetch, what came into sight. @param {IntersectionObserverEntry[]} entries */
  #looked(entries) {
    for (const { target, isIntersecting } of entries) {
      this.#near[isIntersecting ? "add" : "delete"](target);
      if (isIntersecting && this.#late.delete(target) && target instanceof PlotFigure) this.#fetch([target]); // it is as of an older frame
    }
    if (this.#attempt !== undefined && entries.some(({ isIntersecting }) => isIntersecting)) this.#planDrawing();
  }

  #planDrawing() {
    if (!document.hidden) this.#drawTimer ||= setTimeout(() => this.#draw(), this.#restMs);
  }

  /** Draw the figures in sight on; fetch those that lack points, and now and then those that cannot be drawn on. */
  async #draw() {
    const figures = following();
    this.#watch(figures);
    const behind = await this.#drawOn(figures.filter((figure) => this.#near.has(figure)));
    for (const figure of figures) if (!this.#near.has(figure)) this.#late.add(figure); // it is fetched when it comes into sight
    this.#drawTimer = 0;
    const patience = this.#isBatch ? FETCH_MS : Math.min(WHOLE_MS, 2 * FETCH_MS + this.#wholeAt - this.#begunAt);
    this.#fetch(Date.now() - this.#wholeAt > patience ? figures : behind);
  }

  /**
   * Draw figures on, one an animation frame so that the page answers in between; return those that lack points.
   * @param {PlotFigure[]} figures
   */
  async #drawOn(figures) {
    /** @type {PlotFigure[]} */
    const behind = [];
    let cost = 0;
    for (const figure of figures) {
      await animationFrame();
      if (this.#listening.signal.aborted) return [];
      const began = performance.now();
      if ((await drawOn(figure)) === false) behind.push(figure);
      cost += performance.now() - began;
    }
    this.#restMs = Math.max(DRAW_MS, REST * cost);
    return behind;
  }

  /** @param {PlotFigure[]} figures */
  #fetch(figures) {
    for (const figure of figures) (this.#near.has(figure) ? this.#wanted : this.#late).add(figure);
    if (!this.#wanted.size) return;
    this.#fetchTimer ||= setTimeout(() => {
      this.#fetchTimer = 0;
      if (following().every((figure) => this.#wanted.has(figure) || !this.#near.has(figure))) this.#wholeAt = Date.now();
      refresh(this.#wanted);
      this.#wanted.clear();
    }, FETCH_MS);
  }

  /** Take over from the server when the run was last heard of. */
  #hearServer() {
    const heard = panel()?.dataset.heard;
    if (heard) this.#heardAt = Math.max(this.#heardAt || 0, Date.now() - 1000 * Number(heard));
  }

  #showAge() {
    const place = find("[data-run-age]", HTMLElement);
    if (!place) return;
    const { link } = document.body.dataset;
    const silent = Date.now() - this.#heardAt;
    const isSilent = this.#state === "RUNNING" && silent > SILENT_MS;
    const state = (place.dataset.state = link && link !== "live" ? link : isSilent ? "stale" : "live");
    const word = state === "live" ? "" : `${state.toUpperCase()} · `;
    place.textContent = `${word}last event ${Number.isNaN(silent) ? "not received yet" : `${roughSpan(silent / 1000)} ago`}`;
  }

  /** Renew the parts of the page that depend on the state. */
  async #renew() {
    if (this.#busy || document.hidden || TERMINAL.has(this.#state ?? "")) return;
    this.#busy = true; // and for a second after, however many events come
    const renewed = await renewPage();
    if (renewed) this.#hearServer();
    if (renewed?.isWhole) this.#settle(renewed.fresh.querySelector("live-run")?.getAttribute("state")); // else after the next time
    setTimeout(() => (this.#busy = false), FETCH_MS);
    this.#showAge();
  }

  /** @param {string | null | undefined} state */
  #settle(state) {
    if (!state || state === this.#state) return;
    this.#state = state;
    this.setAttribute("state", state);
    document.querySelector("main > .notice[role=status]")?.remove(); // it told of the state before
    refresh(findAll("plot-figure", PlotFigure));
    if (!TERMINAL.has(state)) return;
    this.#rest();
    if (state !== "SUCCEEDED" && document.querySelector("plot-figure")) location.reload(); // its figures are void
  }
}

/** Bring a figure up to the newest point, and let it say which that is. @param {PlotFigure} figure */
async function drawOn(figure) {
  const grown = await grow(figure.canvas);
  const newest = getNewest();
  if (grown && newest) figure.movePlace(newest.frame, newest.at);
  return grown;
}

/** @param {RunProgress} event */
function pace({ fraction, elapsed_s: elapsed }) {
  const frames = Number(panel()?.dataset.frames);
  if (!elapsed || !fraction) return "";
  return frames ? `${((fraction * frames) / elapsed).toFixed(1)} frames/s, about ${roughSpan((elapsed * (1 - fraction)) / fraction)} left` : `for ${roughSpan(elapsed)}`;
}

/** @param {"percent" | "pace" | "message"} name @param {string} text */
function write(name, text) {
  const place = find(`[data-run-${name}]`, HTMLElement);
  if (place) place.textContent = text;
}

/** @param {Iterable<PlotFigure>} figures */
function refresh(figures) {
  for (const figure of figures) figure.dispatchEvent(new CustomEvent("figure-refresh"));
}

customElements.define("live-run", LiveRun);
