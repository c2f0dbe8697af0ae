/**
 * <table data-sortable>: a press on a column's heading sorts its rows, a second press turns them round.
 *
 * A heading's button has data-sort="number" or "word"; a cell's data-value is what counts, else its text. Rows that have
 * no value stay last. The address keeps it, `sort=-<column>` for the largest first (`<table>.<column>` where a page has several),
 * and a page that is loaded or renewed is sorted by it. Without this module the rows stand as the server sent them, the worst first.
 */

const value = (row, place) => row.cells[place].dataset.value ?? row.cells[place].textContent.trim();

function compare(kind, sign) {
  if (kind === "word") return (a, b) => sign * a.localeCompare(b);
  return (a, b) => sign * (a - b);
}

/** The rows in their new order; an absent value is last whichever way they turn. */
function sorted(rows, place, kind, descending) {
  const inOrder = compare(kind, descending ? -1 : 1);
  const known = rows.filter((row) => value(row, place) !== "");
  const unknown = rows.filter((row) => value(row, place) === "");
  known.sort((a, b) => inOrder(value(a, place), value(b, place)));
  return [...known, ...unknown];
}

const slug = (text) => text.toLowerCase().match(/[\p{L}\p{N}]+/gu).join("-");

/** What the address calls a column. */
function nameOf(button) {
  const table = button.closest("table");
  const several = document.querySelectorAll("table[data-sortable]").length > 1;
  return `${several ? `${table.id || slug(table.caption.textContent)}.` : ""}${slug(button.textContent)}`;
}

const columnOf = (sort) => sort.replace(/^-/, "");

function keepInAddress(button) {
  const url = new URL(location.href);
  const name = nameOf(button);
  const ofTable = name.slice(0, name.indexOf(".") + 1);
  const others = url.searchParams.getAll("sort").filter((sort) => ofTable && !columnOf(sort).startsWith(ofTable));
  url.searchParams.delete("sort");
  const sign = button.closest("th").getAttribute("aria-sort") === "descending" ? "-" : "";
  for (const sort of [...others, sign + name]) url.searchParams.append("sort", sort);
  history.replaceState(history.state, "", url);
}

/** Sort the tables as the address says, but not under the focus; a column that is not there leaves its table as it is. */
export function sortByAddress() {
  const buttons = [...document.querySelectorAll("table[data-sortable] thead button")];
  for (const sort of new URLSearchParams(location.search).getAll("sort")) {
    const button = buttons.find((one) => nameOf(one) === columnOf(sort));
    if (button && !button.closest("table").tBodies[0].contains(document.activeElement)) put(button, sort.startsWith("-"));
  }
}

function sort(button) {
  const kind = button.dataset.sort;
  const wasSo = button.closest("th").getAttribute("aria-sort");
  put(button, wasSo ? wasSo === "ascending" : kind === "number"); // the largest first, names from A
  keepInAddress(button);
}

/** Sort by a heading, this way round. */
function put(button, descending) {
  const heading = button.closest("th");
  const body = heading.closest("table").tBodies[0];
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
  body.append(...sorted([...body.rows], heading.cellIndex, button.dataset.sort, descending));
}

document.addEventListener("click", (event) => {
  const button = event.target.closest("table[data-sortable] thead button");
  if (button) sort(button);
});
sortByAddress();
