/**
 * The launch form: keeps the choices consistent and shows what would run before it is queued.
 *
 * After each change the form is sent to the server as a dry run (`intent=check`), the same checks as queueing, and the
 * answer's summary replaces the one shown. Sets of another sensor are hidden, and options of another method disabled. Sensor,
 * set and method are kept in the address, beside the preset or the run that the form began from.
 */
import { send } from "./problem.js";

const QUIET_MS = 400;
const form = document.querySelector("[data-launch]");
let timer = 0;
let flight = null;
let lastSensor = form?.elements.sensor_id?.value;

function showSetsOfSensor() {
  const sensor = form.elements.sensor_id.value;
  for (const select of form.querySelectorAll("select[data-sets]")) {
    for (const option of select.options) {
      const fits = !option.dataset.sensor || option.dataset.sensor === sensor;
      option.hidden = !fits;
      option.disabled = !fits;
    }
    if (select.selectedOptions[0]?.disabled) select.selectedIndex = -1;
    if (!select.value && (select.required || sensor !== lastSensor)) chooseSet(select);
  }
}

/** Take the newest set of the select's own purpose; where there is none, the first that is allowed. */
function chooseSet(select) {
  const allowed = [...select.options].filter((option) => !option.disabled);
  const fitting = allowed.find((option) => option.dataset.purpose === select.dataset.sets) ?? allowed[0];
  if (fitting) fitting.selected = true;
}

function showParametersOfSensor() {
  const sensor = form.elements.sensor_id.value;
  for (const part of form.querySelectorAll("[data-parameters-of]")) {
    const fits = part.dataset.parametersOf === sensor;
    part.hidden = !fits;
    part.disabled = !fits;
  }
}

function showOptionsOfMethod() {
  const method = form.elements.method.value;
  for (const part of form.querySelectorAll("[data-methods]")) {
    const fits = part.dataset.methods.split(" ").includes(method);
    part.disabled = !fits;
    part.classList.toggle("not-of-method", !fits);
  }
}

function showOverconfidence() {
  const warning = form.querySelector("[data-overconfident]");
  if (warning) warning.hidden = form.elements.linearisations?.value !== "1" || form.elements.method.value === "batch";
}

/** Let the address, the form and the presets say what is chosen. */
function keepInAddress() {
  const url = new URL(location.href);
  const { sensor_id: sensor, telemetry_set_id: set, method } = form.elements;
  for (const [name, control] of [["sensor", sensor], ["set", set], ["method", method]]) {
    if (control?.value) url.searchParams.set(name, control.value);
  }
  history.replaceState(history.state, "", url);
  form.action = url;
  for (const button of form.querySelectorAll("[data-preset]")) {
    url.searchParams.delete("method");
    url.searchParams.set("preset", button.dataset.preset);
    button.formAction = url;
  }
}

async function check() {
  flight?.abort();
  flight = new AbortController();
  const place = document.querySelector("[data-dry-run]");
  const body = new URLSearchParams(new FormData(form));
  body.set("intent", "check");
  place.setAttribute("aria-busy", "true");
  try {
    const answer = await fetch(form.action, { method: "POST", body, signal: flight.signal });
    if (answer.status >= 500) return await send(form.action);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    for (const part of ["[data-dry-run]", "[data-changes]"]) {
      const fresh = page.querySelector(part);
      if (fresh) document.querySelector(part)?.replaceChildren(...fresh.childNodes);
    }
    place.removeAttribute("aria-busy");
  } catch (error) {
    if (error.name !== "AbortError") place.textContent = `The check could not be made: ${error.message}`;
  }
}

function changed() {
  if (form.elements.sensor_id) {
    showSetsOfSensor();
    lastSensor = form.elements.sensor_id.value;
    showParametersOfSensor();
  }
  showOptionsOfMethod();
  showOverconfidence();
  clearTimeout(timer);
  if (form.dataset.launch !== "look") timer = setTimeout(check, QUIET_MS);
}

if (form) {
  form.addEventListener("input", () => {
    changed();
    keepInAddress();
  });
  changed();
}
