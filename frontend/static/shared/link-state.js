/**
 * The one event stream of a page, and the light that says whether it can be believed.
 *
 * Every event of GET /api/v1/events is passed on as a DOM event on `document`: boresight:run, boresight:log,
 * boresight:progress, boresight:audit, with the decoded data in `detail`. A page listens there and opens no stream of its
 * own, for a browser allows few connections to one server; that of a run hears the points of its history too. After a
 * break the browser asks for what it missed by its last event id. A hidden page closes its stream. When a stream opens, for
 * what happened since the page was written was not heard, or when the server keeps no more what was missed,
 * boresight:missed says that all should be read again.
 * LIVE: the server was heard from within 20 s. STALE n s: the stream is open but silent. DISCONNECTED: it is broken, or silent
 * for a minute.
 * LOGGED OUT: the log-in has ended, here or elsewhere; a notice says why, and nothing more is asked of the server.
 * The body carries the same word in data-link, so that styles can grey what is no longer fresh, and a change of it is told as
 * boresight:link. Whoever finds that the server does not answer asks for the truth by boresight:doubt.
 */
import { make, need } from "./dom.js";
import { BACKGROUND, Problem, fetchJson } from "./requests.js";

const KINDS = ["run", "log", "progress", "audit", "missed"];
const PROBE_MS = 8000;
const STALE_AFTER_MS = 20000;
const BROKEN_AFTER_MS = 60000;

const light = need("#link-state", HTMLElement);
const said = need("#link-said", HTMLElement); // for screen readers: changes only, not every second
/** @type {EventSource | null} */
let source = null;
let broken = false;
let heardAt = Date.now();
let ended = false;

function heard() {
  heardAt = Date.now();
  broken = false;
  show();
}

function show() {
  if (ended) return;
  const silent = Date.now() - heardAt;
  const state = broken ? "disconnected" : silent > STALE_AFTER_MS ? "stale" : "live";
  const word = state === "stale" ? `STALE ${Math.round(silent / 1000)} s` : state.toUpperCase();
  if (light.textContent !== word) light.textContent = word;
  if (light.dataset.state !== state && light.dataset.state !== "connecting") said.textContent = `Link ${state}`;
  light.dataset.state = state;
  if (document.body.dataset.link !== state) sayState(state);
}

/** @param {LinkState["state"]} state */
function sayState(state) {
  document.body.dataset.link = state === "logged-out" ? "disconnected" : state;
  document.dispatchEvent(new CustomEvent("boresight:link", { detail: { state, sinceMs: heardAt } }));
}

function lose() {
  broken = true;
  show();
}

/** Pass on what the server sent; the types of the events say what that is. @param {string} kind @param {unknown} detail */
const tell = (kind, detail) => document.dispatchEvent(new CustomEvent(`boresight:${kind}`, { detail }));

function open() {
  const run = document.querySelector("live-run")?.getAttribute("run");
  let isNew = true;
  source = new EventSource(`/api/v1/events${run ? `?history=${run}` : ""}`);
  source.onopen = () => {
    const isBack = isNew || broken;
    heard();
    if (isBack) tell("missed", {});
    isNew = false;
  };
  source.onmessage = heard;
  source.onerror = lose;
  source.addEventListener("logged-out", askWhetherEnded);
  for (const kind of KINDS) {
    source.addEventListener(kind, ({ data }) => {
      heard();
      tell(kind, JSON.parse(data));
    });
  }
}

function close() {
  source?.close();
  source = null;
}

/** Ask whether the log-in still holds, and if not say why, with the way back in. */
async function askWhetherEnded() {
  try {
    await fetchJson("/api/v1/sessions/current", BACKGROUND);
  } catch (problem) {
    if (problem instanceof Problem && problem.status === 401) sayEnded(problem.message);
  }
}

/** @param {string} sentence */
function sayEnded(sentence) {
  if (ended) return;
  ended = true;
  close();
  light.textContent = "LOGGED OUT";
  said.textContent = "Disconnected: you are logged out";
  light.dataset.state = "disconnected";
  sayState("logged-out");
  const notice = make("div", { className: "notice notice-serious", id: "log-in-ended", role: "alert" });
  const words = make("p", {});
  const way = make("a", { textContent: "Log in again", href: `/login?next=${encodeURIComponent(location.pathname + location.search)}` });
  words.append(`${sentence} The page shows the last data that arrived. `, way, ".");
  notice.append(words);
  need("#content", HTMLElement).prepend(notice);
  notice.scrollIntoView({ block: "nearest" });
}

/** An idle stream is silent, so ask the server whether it is there. */
async function probe() {
  if (document.hidden || ended) return;
  try {
    const answer = await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(PROBE_MS) });
    if (answer.ok && source?.readyState === EventSource.OPEN) heard();
    if (answer.ok && source?.readyState === EventSource.CLOSED) {
      await askWhetherEnded();
      close();
      if (!ended) open();
    }
  } catch (error) {
    // a busy server may answer late while its stream is open: that is silence, and only a long one is a break
    const isLate = error instanceof DOMException && error.name === "TimeoutError" && source?.readyState === EventSource.OPEN;
    broken = !isLate || Date.now() - heardAt > BROKEN_AFTER_MS;
  }
  show();
}

document.addEventListener("visibilitychange", () => {
  close();
  if (!document.hidden && !ended) open();
});
addEventListener("pagehide", close);
addEventListener("DOMContentLoaded", () => {
  if (!document.hidden && !source) open(); // when every module listens
});
addEventListener("offline", lose);
addEventListener("online", probe);
document.addEventListener("boresight:doubt", lose);
setInterval(probe, PROBE_MS);
setInterval(show, 1000);
