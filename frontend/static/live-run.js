/**
 * <live-run run state>: follows one run while its page is open, from the frame's event stream (link-state.js).
 *
 * Shows progress and the age of the last event; asks the figures to refresh at most once a second; renews every
 * `[data-live]` part of the page from the server when the run changes state. When the stream opens, also after a break,
 * the parts are renewed too, so nothing that happened before is lost.
 */
import { renewParts } from "./live-parts.js";
import { send } from "./problem.js";

const TERMINAL = new Set(["SUCCEEDED", "FAILED", "CANCELLED", "LOST"]);
const REFRESH_MS = 1000;
const RENEW_MS = 5000;

class LiveRun extends HTMLElement {
  #lastEvent = Date.now();
  #figureTimer = 0;
  #timers = [];
  #listening = null;

  connectedCallback() {
    this.state = this.getAttribute("state");
    if (TERMINAL.has(this.state)) return;
    this.#listening = new AbortController();
    const { signal } = this.#listening;
    document.addEventListener("boresight:progress", (event) => this.#progressed(event.detail), { signal });
    document.addEventListener("boresight:run", (event) => this.#moved(event.detail), { signal });
    this.link = new MutationObserver(() => this.#linkChanged());
    this.link.observe(document.body, { attributes: true, attributeFilter: ["data-link"] });
    // events only say that something moved; the page is asked again from time to time in case one was missed
    this.#timers = [setInterval(() => this.#showAge(), 1000), setInterval(() => this.#renew(), RENEW_MS)];
  }

  disconnectedCallback() {
    this.#rest();
  }

  #rest() {
    this.#listening?.abort();
    this.link?.disconnect();
    for (const timer of this.#timers) clearInterval(timer);
    clearTimeout(this.#figureTimer);
  }

  #progressed(event) {
    if (!this.#mine(event)) return;
    this.#lastEvent = Date.now();
    const bar = document.querySelector("[data-run-progress]");
    if (bar && Number.isFinite(event.fraction)) {
      bar.value = event.fraction;
      write("percent", `${Math.round(100 * event.fraction)}\u202f%`);
    }
    if (event.message) write("message", event.message);
    this.#showAge();
    this.#refreshFigures();
    if (this.state === "QUEUED" || !document.querySelector("#parameters table")) this.#renew();
  }

  #moved(event) {
    if (!this.#mine(event)) return;
    this.#lastEvent = Date.now();
    if (event.state !== this.state) this.#renew();
  }

  #mine(event) {
    return String(event?.run_id ?? event?.id) === this.getAttribute("run");
  }

  #linkChanged() {
    const { link } = document.body.dataset;
    if (link === "live" && this.wasLink !== "live") this.#renew(); // what happened before the stream was open was not heard
    this.wasLink = link;
  }

  #refreshFigures() {
    if (this.#figureTimer || document.hidden) return;
    this.#figureTimer = setTimeout(() => {
      this.#figureTimer = 0;
      refresh("plot-figure[data-follows]");
    }, REFRESH_MS);
  }

  #showAge() {
    write("age", `last event ${Math.round((Date.now() - this.#lastEvent) / 1000)}\u202fs ago`);
  }

  /** Replace the parts of the page that depend on the state by what the server says now. */
  async #renew() {
    if (document.hidden || TERMINAL.has(this.state)) return;
    try {
      const answer = await send(location.href, { headers: { Accept: "text/html" } });
      const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
      const all = renewParts(fresh);
      this.#showAge();
      if (all) this.#settle(fresh.querySelector("live-run")?.getAttribute("state")); // else after the next time
    } catch (error) {
      write("age", error.message);
    }
  }

  #settle(state) {
    if (!state || state === this.state) return;
    this.state = state;
    this.setAttribute("state", state);
    document.querySelector("main > .notice[role=status]")?.remove(); // it told of the state before
    refresh("plot-figure");
    if (!TERMINAL.has(state)) return;
    this.#rest();
    if (state !== "SUCCEEDED") location.reload(); // its figures are void
  }
}

function write(name, text) {
  const place = document.querySelector(`[data-run-${name}]`);
  if (place) place.textContent = text;
}

function refresh(selector) {
  for (const figure of document.querySelectorAll(selector)) figure.dispatchEvent(new CustomEvent("figure-refresh"));
}

customElements.define("live-run", LiveRun);
