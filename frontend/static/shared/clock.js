// The UTC clock with day of year, `2026-325 03:04:11Z`, and the ages of everything marked <time class="age">.

/** Two or three digits. */
const pad = (value, width = 2) => String(value).padStart(width, "0");

/** A date as operators read it. */
export function dayOfYear(date) {
  const day = Math.floor((date - Date.UTC(date.getUTCFullYear(), 0, 1)) / 86400000) + 1;
  const time = `${pad(date.getUTCHours())}:${pad(date.getUTCMinutes())}:${pad(date.getUTCSeconds())}`;
  return `${date.getUTCFullYear()}-${pad(day, 3)} ${time}Z`;
}

/** A span in its two largest units, as the server prints it. */
export function span(seconds) {
  const parts = [
    [Math.floor(seconds / 86400), "d"],
    [Math.floor(seconds / 3600) % 24, "h"],
    [Math.floor(seconds / 60) % 60, "min"],
    [Math.floor(seconds) % 60, "s"],
  ].filter(([amount]) => amount > 0);
  return parts.slice(0, 2).map(([amount, unit]) => `${amount}\u202f${unit}`).join(" ");
}

function tick() {
  const now = new Date();
  const clock = document.getElementById("clock");
  if (clock) clock.textContent = dayOfYear(now);
}

function refreshAges() {
  for (const element of document.querySelectorAll("time.age")) {
    const seconds = (Date.now() - Date.parse(element.dateTime)) / 1000;
    element.textContent = seconds < 10 ? "just now" : `${span(seconds)} ago`;
  }
}

tick();
setInterval(tick, 1000);
setInterval(refreshAges, 10000);
