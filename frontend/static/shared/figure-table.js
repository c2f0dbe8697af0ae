/**
 * <details data-figure-table="URL">: the figure's data as a table, fetched as CSV when first opened.
 *
 * Long series are thinned evenly to ROWS rows and say so; the CSV link has them all.
 */
import { send } from "./problem.js";

const ROWS = 120;

/** Split one CSV line, honouring double quotes. */
function cells(line) {
  const found = line.matchAll(/("(?:[^"]|"")*"|[^,]*)(?:,|$)/g);
  const values = Array.from(found, (match) => match[1].replace(/^"|"$/g, "").replaceAll('""', '"'));
  return values.slice(0, -1);
}

function thinned(rows) {
  if (rows.length <= ROWS) return rows;
  const step = (rows.length - 1) / (ROWS - 1);
  return Array.from({ length: ROWS }, (_, index) => rows[Math.round(index * step)]);
}

function row(kind, values) {
  const tr = document.createElement("tr");
  for (const value of values) {
    const cell = Object.assign(document.createElement(kind), { textContent: shown(value) });
    if (kind === "th") cell.scope = "col";
    tr.append(cell);
  }
  return tr;
}

/** Six significant digits are enough to read; an absent cell is a dash. */
function shown(value) {
  if (value === "") return "—";
  const number = Number(value);
  return Number.isFinite(number) && !Number.isInteger(number) ? String(Number(number.toPrecision(6))) : value;
}

function table(text, caption) {
  const lines = text.split(/\r?\n/).filter(Boolean);
  const [head, ...rows] = lines.map(cells);
  const element = document.createElement("table");
  const note = rows.length > ROWS ? ` ${ROWS} of ${rows.length} rows, evenly taken; the CSV has all.` : "";
  element.createCaption().textContent = `${caption}.${note}`;
  element.createTHead().append(row("th", head ?? []));
  element.createTBody().append(...thinned(rows).map((values) => row("td", values)));
  return element;
}

async function fill(details) {
  const place = details.querySelector("[data-table-place]");
  place.textContent = "Loading the table.";
  try {
    const answer = await send(details.dataset.figureTable, { headers: { Accept: "text/csv" } });
    place.replaceChildren(table(await answer.text(), details.dataset.caption));
  } catch (error) {
    place.textContent = error.message;
  }
}

document.addEventListener(
  "toggle",
  (event) => {
    if (event.target.matches?.("details[data-figure-table]") && event.target.open) fill(event.target);
  },
  true,
);
