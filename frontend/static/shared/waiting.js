/**
 * What waits for the person who is logged in: the number in the tab's title and a dot on its icon, and, where it was asked for in this
 * browser, a notification of what has come. It is asked for after events of the server, and by a page in the background, whose stream
 * is closed, once a minute.
 */
import { need } from "./dom.js";
import { BACKGROUND, fetchJson } from "./requests.js";

const AFTER_MS = 3000;
const HIDDEN_MS = 60_000;
const WANTED = "boresight-notify";
const KNOWN = "boresight-waiting";
const TITLE = document.title;
/** @typedef {{ count: number, first: { sentence: string, address: string }[] }} Waiting */

const button = need("#notify", HTMLButtonElement);
const icon = need("link[rel=icon]", HTMLLinkElement);
const plainIcon = icon.href;
let timer = 0;

/** The mark with a dot, as an address. @param {string} mark */
const withDot = (mark) => `data:image/svg+xml,${encodeURIComponent(mark.replace("</svg>", '<circle cx="25" cy="7" r="7" fill="#ff3838" stroke="none"/></svg>'))}`;

/** @param {number} count */
async function mark(count) {
  document.title = count ? `(${count}) ${TITLE}` : TITLE;
  if (!count) icon.href = plainIcon;
  else if (icon.href === plainIcon) icon.href = withDot(await (await fetch(plainIcon)).text());
}

const isWanted = () => localStorage.getItem(WANTED) === "on" && Notification.permission === "granted";

/** Tell what was not there when this browser looked last; several tabs tell it once, by its tag. @param {Waiting} waiting */
function notify({ count, first }) {
  /** @type {{ count: number, addresses: string[] } | null} */
  const known = JSON.parse(localStorage.getItem(KNOWN) ?? "null");
  localStorage.setItem(KNOWN, JSON.stringify({ count, addresses: first.map((one) => one.address) }));
  if (!known || !isWanted()) return;
  const fresh = first.filter((one) => !known.addresses.includes(one.address));
  if (!fresh.length && count <= known.count) return;
  const { sentence, address } = fresh.length === 1 && fresh[0] ? fresh[0] : { sentence: `${count} items are waiting for you.`, address: "/" };
  const told = new Notification("Boresight", { body: sentence, tag: address, icon: plainIcon });
  told.onclick = () => {
    window.focus();
    location.assign(address);
  };
}

async function look() {
  timer = 0;
  /** @type {Waiting | null} */
  const waiting = await fetchJson("/waiting", BACKGROUND).catch(() => null); // the link light says that the server is away
  if (!waiting) return;
  await mark(waiting.count);
  notify(waiting);
}

const soon = () => { timer ||= setTimeout(look, AFTER_MS); };

function show() {
  button.setAttribute("aria-pressed", String(isWanted()));
  button.title = isWanted() ? "Browser notifications are on; press to turn them off" : "Notify me in this browser of new items waiting for me, while a page is open";
}

async function change() {
  const wanted = !isWanted() && (await Notification.requestPermission()) === "granted";
  localStorage.setItem(WANTED, wanted ? "on" : "off");
  show();
}

if ("Notification" in window) {
  button.hidden = false;
  button.addEventListener("click", change);
  show();
}
for (const kind of /** @type {const} */ (["boresight:audit", "boresight:run", "boresight:missed"])) document.addEventListener(kind, soon);
setInterval(() => document.hidden && look(), HIDDEN_MS);
look();
