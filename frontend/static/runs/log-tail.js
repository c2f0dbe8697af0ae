/**
 * <log-tail src run follows>: the log of a run, which grows while the run computes.
 *
 * An event of the feed about the run asks for the lines after the last one shown. Who is at the end stays at the end; who
 * reads further up is not moved, and told how many lines came. Pause keeps the list as it is until it is pressed again.
 */
import { BACKGROUND, send } from "../shared/problem.js";

const WAIT_MS = 400;
const AT_END_PX = 24;

class LogTail extends HTMLElement {
  #timer = 0;
  #unseen = 0;

  connectedCallback() {
    this.list = this.querySelector(".log");
    this.said = this.querySelector("[data-tail]");
    this.newer = this.querySelector("[data-newer]");
    this.newer.addEventListener("click", () => this.#toEnd());
    this.list.addEventListener("scroll", () => this.#isAtEnd() && this.#tell((this.#unseen = 0)));
    this.#toEnd();
    if (!this.hasAttribute("follows")) return;
    this.pause = this.closest("section").querySelector("[data-pause]");
    this.pause.hidden = false;
    this.pause.addEventListener("click", () => this.#press());
    for (const kind of ["run", "log", "missed"]) document.addEventListener(`boresight:${kind}`, (event) => this.#hear(event.detail));
  }

  #hear(event) {
    if (event?.run_id !== undefined && String(event.run_id) !== this.getAttribute("run")) return;
    this.#timer ||= setTimeout(() => this.#read(), WAIT_MS);
    if (/SUCCEEDED|FAILED|CANCELLED|LOST/.test(event?.state)) this.said.textContent = "The run has ended: this is the whole log.";
  }

  #press() {
    this.paused = !this.paused;
    this.pause.setAttribute("aria-pressed", this.paused);
    this.said.textContent = this.paused ? "Paused: newer lines wait." : "Follows the run.";
    if (!this.paused) this.#read();
  }

  async #read() {
    clearTimeout(this.#timer);
    this.#timer = 0;
    if (this.paused) return;
    const after = this.list.lastElementChild?.dataset.line ?? 0;
    try {
      const answer = await send(`${this.getAttribute("src")}&after=${after}`, { headers: { Accept: "text/html", ...BACKGROUND } });
      const lines = new DOMParser().parseFromString(await answer.text(), "text/html").querySelectorAll("li");
      this.#add([...lines].filter((line) => Number(line.dataset.line) > Number(this.list.lastElementChild?.dataset.line ?? 0)));
    } catch (error) {
      this.said.textContent = error.message;
    }
  }

  #add(lines) {
    if (!lines.length) return;
    const follows = this.#isAtEnd();
    this.list.append(...lines);
    this.querySelector(".empty")?.remove();
    if (follows) this.#toEnd();
    else this.#tell((this.#unseen += lines.length));
  }

  #isAtEnd() {
    return this.list.scrollHeight - this.list.scrollTop - this.list.clientHeight < AT_END_PX;
  }

  #toEnd() {
    this.list.scrollTop = this.list.scrollHeight;
    this.#tell((this.#unseen = 0));
  }

  #tell(unseen) {
    this.newer.hidden = !unseen;
    this.newer.textContent = `${unseen} newer ${unseen === 1 ? "line" : "lines"} below`;
  }
}

customElements.define("log-tail", LogTail);
