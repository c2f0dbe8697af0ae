/**
 * <log-tail src run follows>: the log of a run, which grows while the run computes.
 *
 * An event of the feed about the run asks for the lines after the last one shown. Who is at the end stays at the end; who
 * reads further up is not moved, and told how many lines came. Pause keeps the list as it is until it is pressed again.
 */
import { findAll, need } from "../shared/dom.js";
import { fetchPage, describeError } from "../shared/requests.js";

const WAIT_MS = 400;
const AT_END_PX = 24;

class LogTail extends HTMLElement {
  #timer = 0;
  #unseen = 0;
  #isPaused = false;

  connectedCallback() {
    this.#newer.addEventListener("click", () => this.#toEnd());
    this.#list.addEventListener("scroll", () => this.#isAtEnd && this.#tell(0));
    this.#toEnd();
    if (!this.hasAttribute("follows")) return;
    const pause = need("[data-pause]", HTMLElement, this.closest("section") ?? document);
    pause.hidden = false;
    pause.addEventListener("click", () => this.#press(pause));
    for (const kind of /** @type {const} */ (["run", "log", "missed"])) document.addEventListener(`boresight:${kind}`, ({ detail }) => this.#hear(detail));
  }

  get #list() {
    return need(".log", HTMLElement, this);
  }

  get #newer() {
    return need("[data-newer]", HTMLElement, this);
  }

  get #last() {
    const last = this.#list.lastElementChild;
    return last instanceof HTMLElement ? Number(last.dataset.line) : 0;
  }

  get #isAtEnd() {
    const { scrollHeight, scrollTop, clientHeight } = this.#list;
    return scrollHeight - scrollTop - clientHeight < AT_END_PX;
  }

  /** @param {string} words */
  #say(words) {
    need("[data-tail]", HTMLElement, this).textContent = words;
  }

  /** @param {RunEvent | LogEvent | MissedEvent} event */
  #hear(event) {
    if (event.run_id !== undefined && String(event.run_id) !== this.getAttribute("run")) return;
    this.#timer ||= setTimeout(() => this.#read(), WAIT_MS);
    if (event.state && /SUCCEEDED|FAILED|CANCELLED|LOST/.test(event.state)) this.#say("The run has ended: this is the whole log.");
  }

  /** @param {HTMLElement} pause */
  #press(pause) {
    this.#isPaused = !this.#isPaused;
    pause.setAttribute("aria-pressed", String(this.#isPaused));
    this.#say(this.#isPaused ? "Paused: newer lines wait." : "New lines appear here.");
    if (!this.#isPaused) this.#read();
  }

  async #read() {
    clearTimeout(this.#timer);
    this.#timer = 0;
    if (this.#isPaused) return;
    try {
      const lines = await fetchPage(`${this.getAttribute("src")}&after=${this.#last}`);
      if (lines) this.#add(findAll("li", HTMLElement, lines).filter((line) => Number(line.dataset.line) > this.#last));
    } catch (error) {
      this.#say(describeError(error));
    }
  }

  /** @param {HTMLElement[]} lines */
  #add(lines) {
    if (!lines.length) return;
    const follows = this.#isAtEnd;
    this.#list.append(...lines);
    this.querySelector(".empty")?.remove();
    if (follows) this.#toEnd();
    else this.#tell(this.#unseen + lines.length);
  }

  #toEnd() {
    this.#list.scrollTop = this.#list.scrollHeight;
    this.#tell(0);
  }

  /** @param {number} unseen */
  #tell(unseen) {
    this.#unseen = unseen;
    this.#newer.hidden = !unseen;
    this.#newer.textContent = `${unseen} newer ${unseen === 1 ? "line" : "lines"} below`;
  }
}

customElements.define("log-tail", LogTail);
