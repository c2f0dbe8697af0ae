// Keeps a page's regions fresh: after an event of the server the page is read again, and every element with `data-live`
// and an id is replaced by its newer self, unless the person is typing or reading inside it. No state is kept here.

const AFTER_MS = { run: 600, audit: 600, progress: 3000 };
let timer = 0;
let busy = false;
let again = false;

/** Whether something in the region is being used: it is then left alone until the next event. */
const inUse = (region) => region.contains(document.activeElement) && document.activeElement !== document.body;

/** Remember which foldings are open and how far a table was scrolled. */
function replace(region, newer) {
  const open = [...region.querySelectorAll("details")].map((details) => details.open);
  const scrolled = region.querySelector(".scroll")?.scrollLeft ?? 0;
  region.replaceWith(newer);
  for (const [k, details] of newer.querySelectorAll("details").entries()) details.open = open[k] ?? details.open;
  const scroll = newer.querySelector(".scroll");
  if (scroll) scroll.scrollLeft = scrolled;
}

async function refresh() {
  if (busy) {
    again = true;
    return;
  }
  busy = true;
  try {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
    if (answer.redirected || !answer.ok) return;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    for (const region of document.querySelectorAll("[data-live][id]")) {
      const newer = page.getElementById(region.id);
      if (newer && !inUse(region) && newer.innerHTML !== region.innerHTML) replace(region, newer);
    }
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
