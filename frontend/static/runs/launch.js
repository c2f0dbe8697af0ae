/**
 * The launch form: keeps the choices consistent and shows what would run before it is queued.
 *
 * After each change the form is sent to the server as a dry run (`intent=check`), the same checks as queueing, and the
 * answer's summary replaces the one shown. Sets of another sensor are hidden, and options of another method disabled. Data
 * and method are kept in the address, beside the preset or the run that the form began from, and so is every control that
 * differs from how the form begins (`data-begun`): a reload shows the same form. Of a large fleet the form holds the sets of one
 * sensor (`shown`): choosing another, or finding one by its name, asks for the form again.
 */
import { send } from "../shared/problem.js";

const QUIET_MS = 400;
/** Controls that the address always names, and how; without all the data it would say only where to begin. */
const ALWAYS = { sensor_id: "sensor", telemetry_set_id: "set", validation_set_id: "validation_set_id", method: "method" };
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

/** What every control says, by its name; disabled ones too, never hidden ones such as the csrf token. */
function said() {
  const values = new Map();
  for (const control of form.elements) {
    if (!control.name || control.matches("button, [type=hidden]")) continue;
    if (!values.has(control.name)) values.set(control.name, []);
    if (control.value && (control.checked || !control.matches("[type=checkbox], [type=radio]"))) values.get(control.name).push(control.value);
  }
  return values;
}

/** The address that says what is chosen; a control that says nothing is named with nothing. */
function address() {
  const [url, begun] = [new URL(location.href), new URLSearchParams(form.dataset.begun)];
  for (const [name, values] of said()) {
    const key = ALWAYS[name] ?? name;
    const before = begun.getAll(name).filter(Boolean);
    if (ALWAYS[name]) url.searchParams.set(key, values[0] ?? "");
    else url.searchParams.delete(key);
    if (ALWAYS[name] || `${before.sort()}` === `${values.toSorted()}`) continue;
    for (const value of values.length ? values : [""]) url.searchParams.append(key, value);
  }
  return url;
}

/** Let the address, the form and the presets say what is chosen. */
function keepInAddress() {
  const url = address();
  history.replaceState(history.state, "", url);
  form.action = url;
  const beginning = [...url.searchParams].filter(([name]) => ["sensor", "set", "clone", "find"].includes(name));
  for (const button of form.querySelectorAll("[data-preset]")) {
    url.search = new URLSearchParams([...beginning, ["preset", button.dataset.preset]]);
    button.formAction = url;
  }
}

/** Whether another sensor is chosen than the one whose sets the form holds, perhaps before this script was there. */
function isOfAnother() {
  const shown = form.elements.shown?.value;
  return Boolean(shown) && shown !== form.elements.sensor_id.value;
}

/** Ask for the form of another sensor, with everything chosen that holds for any; going back finds this one as it was. */
function openSensor() {
  const url = address();
  for (const name of [...url.searchParams.keys()]) {
    if (["set", "validation_set_id"].includes(name) || name.startsWith("free-")) url.searchParams.delete(name);
  }
  form.elements.sensor_id.value = form.elements.shown.value;
  location.assign(url);
}

/** Find sensors by name, with everything chosen kept. */
function find(event) {
  event.preventDefault();
  const url = address();
  url.searchParams.set("find", event.target.elements.find.value);
  location.assign(url);
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
    for (const part of ["[data-dry-run]", "[data-changes]", "[data-ticked]"]) {
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
  document.querySelector("form[data-find]")?.addEventListener("submit", find);
  form.addEventListener("input", ({ target }) => {
    if (target.type === "search") return;
    if (target.name === "sensor_id" && isOfAnother()) return openSensor();
    changed();
    keepInAddress();
  });
  if (isOfAnother()) openSensor();
  changed();
  if ("answered" in form.dataset) keepInAddress();
}
