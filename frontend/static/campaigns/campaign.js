/**
 * A campaign that is under way: its bar, its moves and its results are asked for again every other second until it has ended.
 *
 * The page is the server's own, so what is shown is what a reload would show. A form that is open is left alone.
 */
import { send } from "../shared/problem.js";
import { sortByAddress } from "../shared/sort-table.js";

const EVERY_MS = 2000;
const PARTS = ["[data-campaign]", "[data-campaign-moves]", "[data-campaign-results]"];

/** Replace a part unless a person is at work in it. */
function renew(fresh, part) {
  const [now, next] = [document.querySelector(part), fresh.querySelector(part)];
  if (now && next && !now.contains(document.activeElement) && !now.querySelector("details[open]")) now.replaceWith(next);
}

async function look() {
  if (document.querySelector("[data-campaign]")?.dataset.campaign !== "under-way") return;
  try {
    const answer = await send(location.href);
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
    for (const part of PARTS) renew(fresh, part);
    sortByAddress();
  } catch {
    // the top bar says that the server is not there; what is shown is the last that arrived
  }
  setTimeout(look, EVERY_MS);
}

setTimeout(look, EVERY_MS);
