/**
 * Security keys (WebAuthn). A button with data-security-key asks the key for one signature and puts its answer into the field that
 * it names. A form with data-security-key-form has what the key is asked in the page: a log-in, or an enrolment. Its button is
 * disabled until this script runs, for the form alone has no answer to send.
 */
import { find, findAll, need } from "../shared/dom.js";
import { describeError, send } from "../shared/requests.js";

const known = "PublicKeyCredential" in window && "parseRequestOptionsFromJSON" in PublicKeyCredential;

/** Ask a security key, and return its answer as the server reads it. @param {string} options @param {boolean} [enrols] */
async function askKey(options, enrols = false) {
  const asked = JSON.parse(options);
  const made = enrols
    ? await navigator.credentials.create({ publicKey: PublicKeyCredential.parseCreationOptionsFromJSON(asked) })
    : await navigator.credentials.get({ publicKey: PublicKeyCredential.parseRequestOptionsFromJSON(asked) });
  if (!(made instanceof PublicKeyCredential)) throw new Error("The security key did not respond; try again.");
  return JSON.stringify(made.toJSON());
}

for (const button of findAll("button[data-security-key]", HTMLButtonElement)) {
  const field = need(`#${button.dataset["securityKey"]}`, HTMLInputElement);
  const said = button.nextElementSibling;
  button.hidden = !known;
  button.addEventListener("click", async () => {
    if (said) said.textContent = "Touch your security key…";
    try {
      const token = need("input[name=csrf_token]", HTMLInputElement).value;
      const answer = await send("/api/v1/second-factors:challenge", { method: "POST", headers: { "X-CSRF-Token": token } });
      field.value = await askKey(JSON.stringify((await answer.json()).options));
      field.type = "password";
      field.readOnly = true;
      if (said) said.textContent = "Your security key responded.";
    } catch (error) {
      if (said) said.textContent = describeError(error);
    }
  });
}

for (const form of findAll("form[data-security-key-form]", HTMLFormElement)) {
  const said = find("[role=status]", HTMLElement, form);
  need("button", HTMLButtonElement, form).disabled = !known;
  if (!known && said) said.textContent = "This browser does not support security keys; use another second factor or a newer browser.";
  form.addEventListener("submit", async (event) => {
    const field = need("input[name=factor]", HTMLInputElement, form);
    if (field.value) return;
    event.preventDefault();
    if (said) said.textContent = "Touch your security key…";
    try {
      field.value = await askKey(form.dataset["options"] ?? "", form.dataset["securityKeyForm"] === "enrol");
      form.submit();
    } catch (error) {
      if (said) said.textContent = `${describeError(error)} Try again, or use another second factor.`;
    }
  });
}
