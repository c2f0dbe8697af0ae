/**
 * <table data-sortable>: a press on a column's heading sorts its rows, a second press turns them round.
 *
 * A heading's button has data-sort="number" or "word"; a cell's data-value is what counts, else its text. Rows that have
 * no value stay last. Without this module the rows stand as the server sent them, the worst first.
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

function sort(button) {
  const heading = button.closest("th");
  const body = heading.closest("table").tBodies[0];
  const kind = button.dataset.sort;
  const wasSo = heading.getAttribute("aria-sort");
  const descending = wasSo ? wasSo === "ascending" : kind === "number"; // the largest first, names from A
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
  body.append(...sorted([...body.rows], heading.cellIndex, kind, descending));
}

document.addEventListener("click", (event) => {
  const button = event.target.closest("table[data-sortable] thead button");
  if (button) sort(button);
});
