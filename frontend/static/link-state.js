// The one event stream of a page, and the light that says whether it can be believed.
//
// Every event of GET /api/v1/events is passed on as a DOM event on `document`: boresight:run, boresight:progress,
// boresight:audit, with the decoded data in `detail`. A page listens there and opens no stream of its own, for a
// browser allows few connections to one server. A hidden page closes its stream and opens it again when shown.
// LIVE: the server was heard from within 20 s. STALE n s: the stream is open but silent. DISCONNECTED: it is broken.
// The body carries the same word in data-link, so that styles can grey what is no longer fresh.

const KINDS = ["run", "progress", "audit"];
const PROBE_MS = 8000;
const STALE_AFTER_MS = 20000;

const light = document.getElementById("link-state");
const said = document.getElementById("link-said"); // for screen readers: changes only, not every second
let source = null;
let broken = false;
let heardAt = Date.now();

function heard() {
  heardAt = Date.now();
  broken = false;
  show();
}

function show() {
  const silent = Date.now() - heardAt;
  const state = broken ? "disconnected" : silent > STALE_AFTER_MS ? "stale" : "live";
  const word = state === "stale" ? `STALE ${Math.round(silent / 1000)} s` : state.toUpperCase();
  if (light.textContent !== word) light.textContent = word;
  if (light.dataset.state !== state && light.dataset.state !== "connecting") said.textContent = `Link ${state}`;
  light.dataset.state = state;
  document.body.dataset.link = state;
}

function decode(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}

function open() {
  source = new EventSource("/api/v1/events");
  source.onopen = heard;
  source.onmessage = heard;
  source.onerror = () => {
    broken = true;
    show();
  };
  for (const kind of KINDS) {
    source.addEventListener(kind, (event) => {
      heard();
      document.dispatchEvent(new CustomEvent(`boresight:${kind}`, { detail: decode(event.data) }));
    });
  }
}

function close() {
  source?.close();
  source = null;
}

/** An idle stream is silent, so ask the server whether it is there. */
async function probe() {
  if (document.hidden) return;
  try {
    const answer = await fetch("/healthz", { cache: "no-store" });
    if (answer.ok && source?.readyState === EventSource.OPEN) heard();
    if (answer.ok && source?.readyState === EventSource.CLOSED) {
      close();
      open();
    }
  } catch {
    broken = true;
  }
  show();
}

document.addEventListener("visibilitychange", () => {
  close();
  if (!document.hidden) open();
});
addEventListener("pagehide", close);
open();
setInterval(probe, PROBE_MS);
setInterval(show, 1000);
