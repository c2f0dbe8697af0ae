/**
 * The runs list: choose rows (Shift chooses a range) to compare, and keep the rows fresh while runs compute.
 *
 * Works without this module too: the check boxes are a plain GET form of /compare. Here what is chosen stands in the
 * address and in every link to another page of the list, so that it is kept over pages, and the rows are renewed after run
 * events, one by one: what has the focus keeps it.
 */
import { send } from "../shared/problem.js";

const MOST = 20;
const RENEW_MS = 1500;

const form = document.querySelector("[data-runs-form]");
let last = null;
let timer = 0;

const boxes = () => [...form.querySelectorAll("[data-list-body] input[name=runs]")];
const chosen = () => [...form.querySelectorAll("input[name=runs]:checked")].map((box) => box.value);

function chooseRange(box) {
  const all = boxes();
  const [from, to] = [all.findIndex((other) => other.value === last), all.indexOf(box)].sort((a, b) => a - b);
  if (from >= 0) for (const between of all.slice(from, to + 1)) between.checked = box.checked;
}

function advice(count) {
  if (count > MOST) return `${count} runs are chosen; at most ${MOST} can be compared. Unselect ${count - MOST}.`;
  if (count === 1) return "Select one more run to compare.";
  return count ? "" : "Select two or more runs to compare them; Shift selects a range.";
}

function showChoice() {
  const count = chosen().length;
  const button = form.querySelector("[data-compare]");
  button.disabled = count < 2 || count > MOST;
  button.textContent = count ? `Compare ${count} runs` : "Compare";
  form.querySelector("[data-compare-words]").textContent = advice(count);
}

const withChoice = (address) => {
  const url = new URL(address, location.href);
  if (chosen().length) url.searchParams.set("runs", chosen().join(","));
  else url.searchParams.delete("runs");
  return url.href.replaceAll("%2C", ",");
};

/** Let the address, the links and the forms of the list carry what is chosen. */
function keepChoice() {
  history.replaceState(null, "", withChoice(location.href));
  for (const link of document.querySelectorAll('main a[href^="/runs?"], main .list-tools a, th a.sort')) link.href = withChoice(link.href);
  for (const tools of document.querySelectorAll(".list-tools form")) {
    tools.querySelector("input[name=runs]")?.remove();
    tools.insertAdjacentHTML("beforeend", `<input type="hidden" name="runs" value="${chosen().join(",")}">`);
  }
}

function compare(event) {
  event.preventDefault();
  location.assign(`/compare?runs=${chosen().join(",")}`);
}

const keyOf = (row) => row.querySelector("input[name=runs]").value;

/** Take over what has changed of a row; its check box stays. */
function renewRow(row, fresh) {
  for (const [k, cell] of [...fresh.cells].entries()) if (k && row.cells[k].innerHTML !== cell.innerHTML) row.cells[k].replaceWith(cell);
  return row;
}

/** Put the server's rows in their places; rows that stay where they were are not moved. */
function renewRows(body, fresh) {
  const known = new Map([...body.rows].map((row) => [keyOf(row), row]));
  let place = body.firstElementChild;
  for (const row of [...fresh.rows]) {
    const next = known.has(keyOf(row)) ? renewRow(known.get(keyOf(row)), row) : row;
    if (next === place) place = place.nextElementSibling;
    else body.insertBefore(next, place);
  }
  while (place) {
    const gone = place;
    place = place.nextElementSibling;
    gone.remove();
  }
}

async function renew() {
  timer = 0;
  try {
    const fresh = new DOMParser().parseFromString(await (await send(location.href)).text(), "text/html").querySelector("[data-list-body]");
    if (!fresh) return;
    const focused = document.activeElement;
    const href = form.contains(focused) && focused.getAttribute("href");
    renewRows(form.querySelector("[data-list-body]"), fresh);
    if (document.activeElement !== focused) (href ? form.querySelector(`a[href="${CSS.escape(href)}"]`) : focused)?.focus({ preventScroll: true });
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
    last = event.target.value;
    showChoice();
    keepChoice();
  });
  form.addEventListener("submit", compare);
  showChoice();
  document.addEventListener("boresight:run", later);
  document.addEventListener("boresight:progress", later);
}
