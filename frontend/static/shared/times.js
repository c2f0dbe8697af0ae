/**
 * Times in the form that the reader chose, which the page's root has as `data-times` and `data-zone`; as the server shows them
 * (boresight.platform.db.times): `2026-325 03:04:05Z`, `2026-11-21 03:04:05Z`, `2026-11-21 03:04:05Z (04:04:05+01:00)`.
 */

const { times: form = "day_of_year", zone = "UTC" } = document.documentElement.dataset;
const DAY_MS = 86_400_000;

/** @param {number} value */
const pad = (value, width = 2) => String(value).padStart(width, "0");

/** Date, clock and offset in the zone. @param {Date} moment */
function inZone(moment) {
  const options = /** @type {const} */ ({
    timeZone: zone, hourCycle: "h23", year: "numeric", month: "2-digit", day: "2-digit", hour: "2-digit", minute: "2-digit",
    second: "2-digit", timeZoneName: "longOffset",
  });
  const parts = new Intl.DateTimeFormat("en-GB", options).formatToParts(moment);
  const found = Object.fromEntries(parts.map(({ type, value }) => [type, value]));
  return {
    date: `${pad(Number(found.year), 4)}-${found.month}-${found.day}`,
    clock: `${found.hour}:${found.minute}:${found.second}`,
    offset: found.timeZoneName?.replace(/^GMT/, "") || "+00:00",
  };
}

/** Print a time to the second. @param {Date} moment */
export function showTime(moment) {
  const [date = "", clock] = moment.toISOString().slice(0, 19).split("T");
  const year = moment.getUTCFullYear();
  if (form === "day_of_year") return `${pad(year, 4)}-${pad(Math.floor((moment.getTime() - Date.UTC(year, 0, 1)) / DAY_MS) + 1, 3)} ${clock}Z`;
  if (form !== "local") return `${date} ${clock}Z`;
  const local = inZone(moment);
  return `${date} ${clock}Z (${local.date === date ? "" : `${local.date} `}${local.clock}${local.offset})`;
}

const STORED_TIME = /\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?Z/g;

/** Print a sentence of the server with every time in it in the reader's form. @param {string} text */
export function showTimes(text) {
  return text.replace(STORED_TIME, (found) => {
    const moment = new Date(found);
    return Number.isNaN(moment.getTime()) ? found : showTime(moment);
  });
}

/** What a time axis is drawn with, in Plotly's words. */
function describeAxis() {
  const day = form === "day_of_year" ? "%Y-%j" : "%Y-%m-%d";
  const tickformatstops = [
    { dtickrange: [null, DAY_MS - 1], value: `%H:%M:%S\n${day}` },
    { dtickrange: [DAY_MS, null], value: day },
  ];
  return { tickformatstops, hoverformat: `${day} %H:%M:%SZ` };
}

/** The offset of the zone at the ends of an axis. @param {string[]} moments */
function describeOffset(moments) {
  const ends = [moments[0], moments.at(-1)].map((text) => inZone(new Date(`${text}Z`)).offset);
  return `${zone} is ${[...new Set(ends)].join(" to ")}`;
}

/** Write the time axes of a figure in the reader's form; under the pointer a local time stands beside. @param {Figure} figure */
export function writeTimes({ data, layout }) {
  const axes = Object.entries(layout).filter(([name, axis]) => /^xaxis\d*$/.test(name) && axis.type === "date");
  for (const [, axis] of axes) Object.assign(axis, describeAxis());
  if (form !== "local") return;
  const names = new Set(axes.map(([name]) => name));
  const drawn = data.filter(({ x, xaxis = "x" }) => Array.isArray(x) && names.has(`xaxis${xaxis.slice(1)}`));
  for (const trace of drawn) {
    trace.hovertext = /** @type {string[]} */ (trace.x).map((text) => showTime(new Date(`${text}Z`)));
    trace.hovertemplate = trace.hovertemplate?.replace("%{x}", "%{hovertext}");
  }
  const moments = drawn.flatMap(({ x }) => /** @type {string[]} */ (x)).sort();
  for (const [, { title }] of axes) if (title?.text && moments.length) title.text += `; ${describeOffset(moments)}`;
}
