/**
 * The runs list: choose rows (Shift chooses a range) to compare, and keep the rows fresh while runs compute.
 *
 * Works without this module too: the check boxes are a plain GET form of /compare. Here the address is made short
 * (`?runs=1,2,3`), the button says how many are chosen, and the table's body is renewed after run events.
 */
import { send } from "./problem.js";

const MOST = 20;
const RENEW_MS = 1500;

const form = document.querySelector("[data-runs-form]");
let last = null;
let timer = 0;

const boxes = () => [...form.querySelectorAll("input[name=runs]")];
const chosen = () => boxes().filter((box) => box.checked);

function chooseRange(box) {
  const all = boxes();
  const [from, to] = [all.indexOf(last), all.indexOf(box)].sort((a, b) => a - b);
  if (from >= 0) for (const between of all.slice(from, to + 1)) between.checked = box.checked;
}

function showChoice() {
  const count = chosen().length;
  const button = form.querySelector("[data-compare]");
  button.disabled = count < 2 || count > MOST;
  button.textContent = count ? `Compare ${count} runs` : "Compare";
  form.querySelector("[data-compare-words]").textContent = advice(count);
}

function advice(count) {
  if (count > MOST) return `${count} runs are chosen; at most ${MOST} can be compared. Unselect ${count - MOST}.`;
  if (count === 1) return "Select one more run to compare.";
  return count ? "" : "Select two or more runs to compare them; Shift selects a range.";
}

function compare(event) {
  event.preventDefault();
  location.assign(`/compare?runs=${chosen().map((box) => box.value).join(",")}`);
}

/** Replace the rows by the server's, keeping what was chosen. */
async function renew() {
  timer = 0;
  const kept = new Set(chosen().map((box) => box.value));
  try {
    const fresh = new DOMParser().parseFromString(await (await send(location.href)).text(), "text/html");
    const body = fresh.querySelector("[data-runs-body]");
    if (!body || form.contains(document.activeElement)) return;
    form.querySelector("[data-runs-body]").replaceChildren(...body.childNodes);
    for (const box of boxes()) box.checked = kept.has(box.value);
    showChoice();
  } catch {
    // the frame's link state says that the server is away; the rows shown are the last that arrived
  }
}

/** Ask for the rows again soon after anything moved; the frame's one event stream says when. */
function later() {
  timer ||= setTimeout(renew, RENEW_MS);
}

if (form) {
  form.addEventListener("click", (event) => {
    if (event.target.name !== "runs") return;
    if (event.shiftKey) chooseRange(event.target);
    last = event.target;
    showChoice();
  });
  form.addEventListener("submit", compare);
  showChoice();
  document.addEventListener("boresight:run", later);
  document.addEventListener("boresight:progress", later);
}
