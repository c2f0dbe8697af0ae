/**
 * Tables that are wider than their place: set closer first (`data-fit="close"`), then, where there is room for columns, with
 * times and states on two lines (`data-fit="closer"`), and where that is not enough a card a row (`data-fit="cards"`), each
 * cell under the heading of its column, so that nothing lies beyond an edge. One whose columns are to be compared
 * (`data-pinned`) keeps them beside each other where there is room for a few: its first column and the reference stay in sight
 * while the others are scrolled in its own place (`data-fit="pinned"`), which fades where more follows (`data-more`).
 * A long name or path in a cell may be parted after _ and /, so that none of its words is.
 *
 * And bars that stay in sight begin where the top bar ends, however many lines it takes.
 */
import { find, findAll, make } from "./dom.js";

const ROOM_FOR_COLUMNS_PX = 640;

/** @type {WeakMap<Element, number>} */
const widths = new WeakMap();

/** Give every cell the heading of its column. @param {HTMLTableElement} table */
function label(table) {
  const cells = [...(table.tHead?.rows[table.tHead.rows.length - 1]?.cells ?? [])];
  const headings = cells.flatMap((cell) => Array(cell.colSpan).fill(cell.textContent?.trim()));
  for (const row of [...table.tBodies].flatMap((body) => [...body.rows])) {
    let column = 0;
    for (const cell of row.cells) {
      if (cell.colSpan === 1) cell.dataset.label = headings[column] ?? "";
      column += cell.colSpan;
    }
  }
}

const LONG_NAME = /(?=\S{16})\S*[_/]\S/;

/** @param {HTMLTableElement} table */
function offerBreaks(table) {
  const walker = document.createTreeWalker(table, NodeFilter.SHOW_TEXT);
  /** @type {Text[]} */
  const found = [];
  while (walker.nextNode()) {
    const text = walker.currentNode;
    if (text instanceof Text && LONG_NAME.test(text.data) && !text.parentElement?.closest("option, textarea, svg")) found.push(text);
  }
  for (const text of found) text.replaceWith(...text.data.split(/(?<=[_/])(?=\S)/).flatMap((part, k) => (k ? [make("wbr", {}), part] : [part])));
}

/** @param {HTMLTableElement} table */
function fit(table) {
  const place = table.parentElement;
  if (!place?.clientWidth || !table.tHead) return;
  widths.set(place, place.clientWidth);
  delete table.dataset.fit;
  place.onscroll = null;
  place.removeAttribute("data-more");
  const hasRoom = place.clientWidth >= ROOM_FOR_COLUMNS_PX;
  const isPinned = hasRoom && table.hasAttribute("data-pinned");
  for (const way of ["close", ...(hasRoom ? ["closer"] : []), isPinned ? "pinned" : "cards"]) {
    if (place.scrollWidth <= place.clientWidth) return;
    table.dataset.fit = way;
  }
  if (!isPinned) return label(table);
  table.style.setProperty("--first-column", `${table.tHead.rows[0]?.cells[0]?.offsetWidth ?? 0}px`);
  place.onscroll = () => place.toggleAttribute("data-more", place.scrollLeft + place.clientWidth < place.scrollWidth - 1);
  place.onscroll(new Event("scroll"));
}

/** @param {ParentNode} root */
const findTables = (root) => [root, ...findAll("table.data", HTMLElement, root)].filter((one) => one instanceof HTMLTableElement);

const watched = new ResizeObserver((entries) => {
  const changed = entries.map(({ target }) => target).filter((place) => widths.get(place) !== place.clientWidth);
  if (changed.length) requestAnimationFrame(() => changed.flatMap(findTables).forEach(fit));
});

/** @param {ParentNode} root */
function fitAll(root) {
  for (const table of findTables(root)) {
    offerBreaks(table);
    fit(table);
    if (table.parentElement) watched.observe(table.parentElement);
  }
}

// Parts that are renewed, and answers that are laid into a page, are fitted before they are painted.
new MutationObserver((records) => {
  for (const part of records.flatMap((record) => [...record.addedNodes])) if (part instanceof HTMLElement) fitAll(part);
}).observe(document.body, { childList: true, subtree: true });
fitAll(document);

for (const tab of findAll(".tabs [aria-current]", HTMLElement)) { // on a telephone its row is scrolled sideways
  const row = tab.parentElement;
  if (row) new ResizeObserver(() => {
    if (row.scrollWidth > row.clientWidth) row.scrollLeft = tab.offsetLeft - row.offsetLeft - 12;
  }).observe(row);
}

const top = find(".top", HTMLElement);
if (top) {
  new ResizeObserver(() => {
    const height = getComputedStyle(top).position === "sticky" ? top.offsetHeight : 0;
    document.body.style.setProperty("--top-height", `${height}px`);
  }).observe(top);
}
