/**
 * <table data-sortable>: a press on a column's heading sorts its rows, a second press turns them round.
 *
 * A heading's button has data-sort="number" or "word"; a cell's data-value is what counts, else its text. Rows that have
 * no value stay last. The address keeps it, `sort=-<column>` for the largest first (`<table>.<column>` where a page has several),
 * and a page that is loaded or renewed is sorted by it. Without this module the rows stand as the server sent them, the worst first.
 */
import { around, findAll } from "./dom.js";

/** A heading's button with the parts of its table. */
class Heading {
  /** @param {HTMLElement} button */
  constructor(button) {
    this.button = button;
    this.cell = /** @type {HTMLTableCellElement} */ (button.closest("th"));
    this.table = /** @type {HTMLTableElement} */ (button.closest("table"));
    this.body = /** @type {HTMLTableSectionElement} */ (this.table.tBodies[0]);
  }

  get isByNumber() {
    return this.button.dataset.sort === "number";
  }

  /** What the address calls the column. */
  get name() {
    const several = document.querySelectorAll("table[data-sortable]").length > 1;
    return `${several ? `${this.table.id || slug(this.table.caption?.textContent)}.` : ""}${slug(this.button.textContent)}`;
  }

  /** What counts of a row. @param {HTMLTableRowElement} row */
  value(row) {
    const cell = row.cells[this.cell.cellIndex];
    return cell?.dataset.value ?? cell?.textContent?.trim() ?? "";
  }

  /** Sort by this column, this way round; an absent value is last whichever way the rows turn. */
  sort(descending = false) {
    for (const other of this.table.querySelectorAll("thead th")) other.removeAttribute("aria-sort");
    this.cell.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const [sign, rows] = [descending ? -1 : 1, [...this.body.rows]];
    /** @type {(a: string, b: string) => number} */
    const compare = this.isByNumber ? (a, b) => Number(a) - Number(b) : (a, b) => a.localeCompare(b);
    const known = rows.filter((row) => this.value(row) !== "").sort((a, b) => sign * compare(this.value(a), this.value(b)));
    this.body.append(...known, ...rows.filter((row) => this.value(row) === ""));
  }

  keepInAddress() {
    const url = new URL(location.href);
    const { name } = this;
    const ofTable = name.slice(0, name.indexOf(".") + 1);
    const others = url.searchParams.getAll("sort").filter((sort) => ofTable && !getColumn(sort).startsWith(ofTable));
    url.searchParams.delete("sort");
    const sign = this.cell.getAttribute("aria-sort") === "descending" ? "-" : "";
    for (const sort of [...others, sign + name]) url.searchParams.append("sort", sort);
    history.replaceState(history.state, "", url);
  }
}

/** @param {string | null | undefined} text */
const slug = (text) => (text ?? "").toLowerCase().match(/[\p{L}\p{N}]+/gu)?.join("-") ?? "";
/** @param {string} sort */
const getColumn = (sort) => sort.replace(/^-/, "");

/** Sort the tables as the address says, but not under the focus; a column that is not there leaves its table as it is. */
function sortByAddress() {
  const headings = findAll("table[data-sortable] thead button", HTMLElement).map((button) => new Heading(button));
  for (const sort of new URLSearchParams(location.search).getAll("sort")) {
    const heading = headings.find((one) => one.name === getColumn(sort));
    if (heading && !heading.body.contains(document.activeElement)) heading.sort(sort.startsWith("-"));
  }
}

document.addEventListener("click", (event) => {
  const button = around(event, "table[data-sortable] thead button");
  if (!(button instanceof HTMLElement)) return;
  const heading = new Heading(button);
  const was = heading.cell.getAttribute("aria-sort");
  heading.sort(was ? was === "ascending" : heading.isByNumber); // the largest first, names from A
  heading.keepInAddress();
});
document.addEventListener("boresight:renewed", sortByAddress);
sortByAddress();
