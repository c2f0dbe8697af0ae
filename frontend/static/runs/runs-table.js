/**
 * The runs list: choose rows (Shift chooses a range) to compare, assess or archive, and keep the rows fresh while runs compute.
 *
 * Works without this module too: the check boxes are a plain GET form of /compare. Here what is chosen stands in the
 * address and in every link to another page of the list, so that it is kept over pages, and the rows are renewed after run
 * events, one by one: what has the focus keeps it.
 */
import { find, findAll, make, need } from "../shared/dom.js";
import { fetchPage } from "../shared/requests.js";

const MOST = 20;
const RENEW_MS = 1500;

const form = find("[data-runs-form]", HTMLFormElement);
/** @type {string | null} */
let last = null;
let timer = 0;

/** @param {HTMLFormElement} form */
const boxes = (form) => findAll("[data-list-body] input[name=runs]", HTMLInputElement, form);
/** @param {HTMLFormElement} form */
const chosen = (form) => findAll("input[name=runs]:checked", HTMLInputElement, form).map((box) => box.value).join(",");

/** @param {HTMLFormElement} form @param {HTMLInputElement} box */
function chooseRange(form, box) {
  const all = boxes(form);
  const [from, to] = [all.findIndex((other) => other.value === last), all.indexOf(box)];
  if (from >= 0) for (const between of all.slice(Math.min(from, to), Math.max(from, to) + 1)) between.checked = box.checked;
}

/** @param {number} count */
function advice(count) {
  if (count > MOST) return `${count} runs are chosen; at most ${MOST} can be compared. Unselect ${count - MOST}.`;
  if (count === 1) return "1 run selected; select one more to compare.";
  return count ? `${count} runs selected.` : "Select two or more runs to compare them; Shift selects a range.";
}

/** @param {HTMLFormElement} form */
function showChoice(form) {
  const count = form.querySelectorAll("input[name=runs]:checked").length;
  const button = need("[data-compare]", HTMLButtonElement);
  button.disabled = count < 2 || count > MOST;
  button.textContent = count ? `Compare ${count} runs` : "Compare";
  need("[data-compare-words]", HTMLElement).textContent = advice(count);
  const batch = find("[data-runs-batch]", HTMLFormElement);
  if (!batch) return;
  need("input[name=runs]", HTMLInputElement, batch).value = chosen(form);
  for (const act of findAll("button", HTMLButtonElement, batch)) act.disabled = !count;
}

/** Let the address, the links and the forms of the list carry what is chosen. @param {HTMLFormElement} form */
function keepChoice(form) {
  const runs = chosen(form);
  /** @param {string} address */
  const withChoice = (address) => {
    const url = new URL(address, location.href);
    if (runs) url.searchParams.set("runs", runs);
    else url.searchParams.delete("runs");
    return url.href.replaceAll("%2C", ",");
  };
  history.replaceState(null, "", withChoice(location.href));
  for (const link of findAll('main a[href^="/runs?"], main .list-tools a, th a.sort', HTMLAnchorElement)) link.href = withChoice(link.href);
  for (const tools of findAll(".list-tools form", HTMLFormElement)) {
    tools.querySelector("input[name=runs]")?.remove();
    tools.append(make("input", { type: "hidden", name: "runs", value: runs }));
  }
}

/** @param {HTMLTableRowElement} row */
const getKey = (row) => need("input[name=runs]", HTMLInputElement, row).value;

/** Take over what has changed of a row; its check box stays. @param {HTMLTableRowElement} row @param {HTMLTableRowElement} fresh */
function renewRow(row, fresh) {
  for (const [k, cell] of [...fresh.cells].entries()) if (k && row.cells[k]?.innerHTML !== cell.innerHTML) row.cells[k]?.replaceWith(cell);
  return row;
}

/**
 * Put the server's rows in their places; rows that stay where they were are not moved.
 * @param {HTMLTableSectionElement} body
 * @param {HTMLTableSectionElement} fresh
 */
function renewRows(body, fresh) {
  const known = new Map([...body.rows].map((row) => [getKey(row), row]));
  let place = body.firstElementChild;
  for (const row of [...fresh.rows]) {
    const old = known.get(getKey(row));
    const next = old ? renewRow(old, row) : row;
    if (next === place) place = place.nextElementSibling;
    else body.insertBefore(next, place);
  }
  while (place) {
    const gone = place;
    place = place.nextElementSibling;
    gone.remove();
  }
}

/** @param {HTMLFormElement} form */
async function renew(form) {
  timer = 0;
  const page = await fetchPage().catch(() => null); // the link light says that the server is away
  const fresh = page && find("[data-list-body]", HTMLTableSectionElement, page);
  if (!fresh) return;
  const focused = document.activeElement;
  const href = form.contains(focused) && focused?.getAttribute("href");
  renewRows(need("[data-list-body]", HTMLTableSectionElement, form), fresh);
  if (document.activeElement !== focused) {
    const again = href ? form.querySelector(`a[href="${CSS.escape(href)}"]`) : focused;
    if (again instanceof HTMLElement) again.focus({ preventScroll: true });
  }
  showChoice(form);
}

if (form) {
  form.addEventListener("click", (event) => {
    const box = event.target;
    if (!(box instanceof HTMLInputElement) || box.name !== "runs") return;
    if (event.shiftKey) chooseRange(form, box);
    last = box.value;
    showChoice(form);
    keepChoice(form);
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    location.assign(`/compare?runs=${chosen(form)}`);
  });
  showChoice(form);
  // the rows are asked for again soon after anything moved; the frame's one event stream says when
  const later = () => { timer ||= setTimeout(() => renew(form), RENEW_MS); };
  document.addEventListener("boresight:run", later);
  document.addEventListener("boresight:progress", later);
}
