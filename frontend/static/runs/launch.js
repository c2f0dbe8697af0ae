/**
 * <form data-launch>: keeps the choices of the launch form consistent and shows what would run before it is queued.
 *
 * After each change the form is sent to the server as a dry run (`intent=check`), the same checks as queueing, and the
 * answer's summary replaces the one shown. Sets of another sensor are hidden, and options of another method disabled. Data
 * and method are kept in the address, beside the preset or the run that the form began from, and so is every control that
 * differs from how the form begins (`data-begun`): a reload shows the same form. Of a large fleet the form holds the sets of one
 * sensor (`shown`): choosing another, or finding one by its name, asks for the form again.
 */
import { find, findAll, need } from "../shared/dom.js";
import { parsePage, send, describeError } from "../shared/requests.js";

const QUIET_MS = 400;
/**
 * Controls that the address always names, and how; without all the data it would say only where to begin.
 * @type {Record<string, string>}
 */
const ALWAYS = { sensor_id: "sensor", telemetry_set_id: "set", validation_set_id: "validation_set_id", method: "method" };
const KEPT = ["sensor", "set", "clone", "find"]; // beside a preset
const TICKS = "[type=checkbox], [type=radio]";

class LaunchForm {
  #timer = 0;
  isUnchecked = false;
  #request = new AbortController();

  /** @param {HTMLFormElement} form */
  constructor(form) {
    this.form = form;
    this.sensorChoice = find("#sensor_id", HTMLSelectElement, form);
    this.lastSensor = this.sensor;
    find("form[data-find]", HTMLFormElement)?.addEventListener("submit", (event) => this.#find(event));
    form.addEventListener("input", ({ target }) => this.#heard(target));
    document.addEventListener("boresight:link", ({ detail }) => {
      if (detail.state === "live" && this.isUnchecked) this.#changed(); // the server is back
    });
    if (this.#isOfAnother) this.#openSensor();
    this.#changed();
    if ("answered" in form.dataset) this.#keepInAddress();
  }

  get sensor() {
    return this.sensorChoice?.value ?? "";
  }

  /** The sensor whose sets the form holds; none where it holds all. */
  get #shown() {
    return find("input[name=shown]", HTMLInputElement, this.form)?.value;
  }

  get #method() {
    return find("input[name=method]:checked", HTMLInputElement, this.form)?.value ?? "";
  }

  /** Whether another sensor is chosen than the one whose sets the form holds, perhaps before this script was there. */
  get #isOfAnother() {
    return Boolean(this.#shown) && this.#shown !== this.sensor;
  }

  /** @param {EventTarget | null} target */
  #heard(target) {
    if (target instanceof HTMLInputElement && target.type === "search") return;
    if (target === this.sensorChoice && this.#isOfAnother) return this.#openSensor();
    this.#changed();
    this.#keepInAddress();
  }

  #changed() {
    if (this.sensorChoice) {
      this.#showSetsOfSensor();
      this.lastSensor = this.sensor;
      for (const part of findAll("[data-parameters-of]", HTMLFieldSetElement, this.form)) part.hidden = part.disabled = part.dataset.parametersOf !== this.sensor;
    }
    for (const part of findAll("[data-methods]", HTMLFieldSetElement, this.form)) {
      part.disabled = !part.dataset.methods?.split(" ").includes(this.#method);
      part.classList.toggle("not-of-method", part.disabled);
    }
    const warning = find("[data-overconfident]", HTMLElement, this.form);
    if (warning) warning.hidden = find("#linearisations", HTMLInputElement, this.form)?.value !== "1" || this.#method === "batch";
    clearTimeout(this.#timer);
    if (this.form.dataset.launch === "look") return;
    this.#request.abort();
    need("[data-dry-run]", HTMLElement).setAttribute("aria-busy", "true"); // what it says is of the choices before
    this.#timer = setTimeout(() => this.#check(), QUIET_MS);
  }

  #showSetsOfSensor() {
    for (const select of findAll("select[data-sets]", HTMLSelectElement, this.form)) {
      for (const option of select.options) option.hidden = option.disabled = Boolean(option.dataset.sensor) && option.dataset.sensor !== this.sensor;
      if (select.selectedOptions[0]?.disabled) select.selectedIndex = -1;
      if (!select.value && (select.required || this.sensor !== this.lastSensor)) chooseSet(select);
    }
    const first = find("#telemetry_set_id", HTMLSelectElement, this.form)?.value;
    for (const label of findAll("[data-further] label", HTMLLabelElement, this.form)) {
      const box = need("input", HTMLInputElement, label);
      label.hidden = box.disabled = label.dataset.sensor !== this.sensor || box.value === first;
    }
  }

  /** What every control says, by its name; disabled ones too, never hidden ones such as the csrf token. */
  #said() {
    /** @type {Map<string, string[]>} */
    const said = new Map();
    for (const control of findAll("input:not([type=hidden]), select, textarea", HTMLElement, this.form)) {
      if (!isControl(control) || !control.name || control.form !== this.form) continue;
      const values = said.get(control.name) ?? [];
      said.set(control.name, values);
      if (control.value && (!control.matches(TICKS) || control.matches(":checked"))) values.push(control.value);
    }
    return said;
  }

  /** The address that says what is chosen; a control that says nothing is named with nothing. */
  #address() {
    const [url, begun] = [new URL(location.href), new URLSearchParams(this.form.dataset.begun)];
    for (const [name, values] of this.#said()) {
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
  #keepInAddress() {
    const url = this.#address();
    history.replaceState(history.state, "", url);
    this.form.action = url.href;
    const beginning = [...url.searchParams].filter(([name]) => KEPT.includes(name));
    for (const button of findAll("[data-preset]", HTMLButtonElement, this.form)) {
      url.search = `${new URLSearchParams([...beginning, ["preset", button.dataset.preset ?? ""]])}`;
      button.formAction = url.href;
    }
  }

  /** Ask for the form of another sensor, with everything chosen that holds for any; going back finds this one as it was. */
  #openSensor() {
    const url = this.#address();
    for (const name of [...url.searchParams.keys()]) {
      if (["set", "validation_set_id", "joint_set_ids", "prior"].includes(name) || name.startsWith("free-")) url.searchParams.delete(name);
    }
    if (this.sensorChoice) this.sensorChoice.value = this.#shown ?? "";
    location.assign(url);
  }

  /** Find sensors by name, with everything chosen kept. @param {SubmitEvent} event */
  #find(event) {
    event.preventDefault();
    const url = this.#address();
    url.searchParams.set("find", need("#find", HTMLInputElement).value);
    location.assign(url);
  }

  /** The form as it would be sent. */
  get #body() {
    const body = new URLSearchParams();
    for (const [name, value] of new FormData(this.form)) body.append(name, String(value));
    body.set("intent", "check");
    return body;
  }

  async #check() {
    this.#request.abort();
    this.#request = new AbortController();
    const { signal } = this.#request;
    const place = need("[data-dry-run]", HTMLElement);
    try {
      const answer = await fetch(this.form.action, { method: "POST", body: this.#body, signal });
      if (answer.status >= 500) await send(this.form.action);
      const page = await parsePage(answer);
      this.isUnchecked = false;
      for (const part of ["[data-dry-run]", "[data-changes]", "[data-ticked]"]) {
        const fresh = page.querySelector(part);
        if (fresh) document.querySelector(part)?.replaceChildren(...fresh.childNodes);
      }
    } catch (error) {
      if (signal.aborted) return;
      this.isUnchecked = true;
      place.textContent = `The check failed: ${describeError(error)}`;
    }
    place.removeAttribute("aria-busy");
  }
}

/** @param {Element} element @returns {element is HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement} */
const isControl = (element) => element instanceof HTMLInputElement || element instanceof HTMLSelectElement || element instanceof HTMLTextAreaElement;

/** Take the newest set of the select's own purpose; where there is none, the first that is allowed. @param {HTMLSelectElement} select */
function chooseSet(select) {
  const allowed = [...select.options].filter((option) => !option.disabled);
  const fitting = allowed.find((option) => option.dataset.purpose === select.dataset.sets) ?? allowed[0];
  if (fitting) fitting.selected = true;
}

const form = find("form[data-launch]", HTMLFormElement);
if (form) new LaunchForm(form);
