/** Keeps a page's live parts fresh: after an event of the server the page is read again, and they are renewed from it. */
import { renewPage } from "./renew-page.js";

/** @satisfies {Partial<Record<keyof FeedEventMap, number>>} */
const AFTER_MS = { "boresight:run": 600, "boresight:audit": 600, "boresight:missed": 600, "boresight:progress": 3000 };
let timer = 0;
let busy = false;
let again = false;

async function refresh() {
  again = busy;
  if (busy) return;
  busy = true;
  const renewed = await renewPage();
  busy = false;
  if (again) soon(AFTER_MS["boresight:run"]);
  else if (renewed && !renewed.isWhole) soon(AFTER_MS["boresight:progress"]);
}

/** Read the page after a while, however many events come until then. @param {number} afterMs */
function soon(afterMs) {
  timer ||= setTimeout(() => {
    timer = 0;
    refresh();
  }, afterMs);
}

for (const [kind, afterMs] of Object.entries(AFTER_MS)) document.addEventListener(kind, () => soon(afterMs));
