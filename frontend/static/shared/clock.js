/** The UTC clock with day of year, `2026-325 03:04:11Z`, and the ages of everything marked <time class="age">. */
import { findAll, make } from "./dom.js";

/** @param {number} value */
const pad = (value, width = 2) => String(value).padStart(width, "0");

/** A date as operators read it. @param {Date} date */
function dayOfYear(date) {
  const day = Math.floor((date.getTime() - Date.UTC(date.getUTCFullYear(), 0, 1)) / 86400000) + 1;
  const time = `${pad(date.getUTCHours())}:${pad(date.getUTCMinutes())}:${pad(date.getUTCSeconds())}`;
  return `${date.getUTCFullYear()}-${pad(day, 3)} ${time}Z`;
}

/** A span in its two largest units, as the server prints it. @param {number} seconds */
function span(seconds) {
  const parts = [
    { amount: Math.floor(seconds / 86400), unit: "d" },
    { amount: Math.floor(seconds / 3600) % 24, unit: "h" },
    { amount: Math.floor(seconds / 60) % 60, unit: "min" },
    { amount: Math.floor(seconds) % 60, unit: "s" },
  ].filter(({ amount }) => amount > 0);
  return parts.slice(0, 2).map(({ amount, unit }) => `${amount}\u202f${unit}`).join(" ");
}

/** Print a span of time: `12 s`, `4 min`, `3.2 h`. @param {number} seconds */
export function roughSpan(seconds) {
  if (seconds < 100) return `${Math.round(seconds)}\u202fs`;
  return seconds < 6000 ? `${Math.round(seconds / 60)}\u202fmin` : `${(seconds / 3600).toFixed(1)}\u202fh`;
}

function tick() {
  const clock = document.getElementById("clock");
  if (clock) clock.textContent = dayOfYear(new Date());
}

/** @param {HTMLTimeElement} element */
function refreshAge(element) {
  const seconds = (Date.now() - Date.parse(element.dateTime)) / 1000;
  element.textContent = seconds < 10 ? "just now" : `${span(seconds)} ago`;
}

const refreshAges = () => findAll("time.age", HTMLTimeElement).forEach(refreshAge);

/** How long ago a time was, kept up to date; the time itself in its tooltip. @param {string} utc */
export function makeAge(utc) {
  const element = make("time", { className: "age", dateTime: utc, title: `${utc.slice(0, 19)} UTC` });
  refreshAge(element);
  return element;
}

tick();
setInterval(tick, 1000);
setInterval(refreshAges, 10000);
