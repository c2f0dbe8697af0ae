// Keeps a page's live parts fresh: after an event of the server the page is read again, and they are renewed from it.
import { renewParts } from "./live-parts.js";
import { BACKGROUND } from "./problem.js";

const AFTER_MS = { run: 600, audit: 600, missed: 600, progress: 3000 };
let timer = 0;
let busy = false;
let again = false;

async function refresh() {
  if (busy) {
    again = true;
    return;
  }
  busy = true;
  try {
    const answer = await fetch(location.href, { headers: { Accept: "text/html", ...BACKGROUND } });
    if (answer.redirected || !answer.ok) return; // link-state.js says so where the log-in has ended
    const all = renewParts(new DOMParser().parseFromString(await answer.text(), "text/html"));
    if (!all) soon(AFTER_MS.progress);
  } catch {
    // the link light tells that the server is away; the last data stay
  } finally {
    busy = false;
    if (again) {
      again = false;
      soon(AFTER_MS.run);
    }
  }
}

/** Read the page after a while, however many events come until then. */
function soon(afterMs) {
  timer ||= setTimeout(() => {
    timer = 0;
    refresh();
  }, afterMs);
}

for (const [kind, afterMs] of Object.entries(AFTER_MS)) document.addEventListener(`boresight:${kind}`, () => soon(afterMs));
