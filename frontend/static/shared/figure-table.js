/**
 * <details data-figure-table="URL">: the figure's data as a table, fetched as CSV when first opened.
 *
 * Long series are thinned evenly to ROWS rows and say so; the CSV link has them all.
 */
import { make, need } from "./dom.js";
import { MINUS, number } from "./numbers.js";
import { send, describeError } from "./requests.js";

const ROWS = 120;

/** Split one CSV line, honouring double quotes. @param {string} line */
function cells(line) {
  const found = line.matchAll(/("(?:[^"]|"")*"|[^,]*)(?:,|$)/g);
  const values = Array.from(found, ([, cell = ""]) => cell.replace(/^"|"$/g, "").replaceAll('""', '"'));
  return values.slice(0, -1);
}

/** @param {string[][]} rows */
function thinned(rows) {
  if (rows.length <= ROWS) return rows;
  const step = (rows.length - 1) / (ROWS - 1);
  return Array.from({ length: ROWS }, (_, index) => rows[Math.round(index * step)] ?? []);
}

/** @param {"th" | "td"} kind @param {string[]} values */
function row(kind, values) {
  const tr = make("tr", {});
  tr.append(...values.map((value) => make(kind, { textContent: shown(value), ...(kind === "th" && { scope: "col" }) })));
  return tr;
}

/** Six significant digits are enough to read; an absent cell is a dash. @param {string} value */
function shown(value) {
  if (value === "") return "–";
  if (/^-?\d+(\.0)?$/.test(value)) return value.replace(".0", "").replace("-", MINUS); // of a star or a frame: not parted
  return Number.isFinite(Number(value)) ? number(Number(value), 6) : value;
}

/** @param {string} text @param {string | undefined} caption */
function table(text, caption) {
  const [head = [], ...rows] = text.split(/\r?\n/).filter(Boolean).map(cells);
  const element = make("table", {});
  const note = rows.length > ROWS ? ` ${ROWS} of ${rows.length} rows, evenly spaced; the CSV has all.` : "";
  element.createCaption().textContent = `${caption}.${note}`;
  element.createTHead().append(row("th", head));
  element.createTBody().append(...thinned(rows).map((values) => row("td", values)));
  return element;
}

/** @param {HTMLDetailsElement} details */
async function fill(details) {
  const place = need("[data-table-place]", HTMLElement, details);
  place.textContent = "Loading the table.";
  try {
    const answer = await send(details.dataset.figureTable ?? "", { headers: { Accept: "text/csv" } });
    place.replaceChildren(table(await answer.text(), details.dataset.caption));
  } catch (error) {
    place.textContent = describeError(error);
  }
}

document.addEventListener(
  "toggle",
  ({ target }) => {
    if (target instanceof HTMLDetailsElement && target.matches("[data-figure-table]") && target.open) fill(target);
  },
  true,
);
