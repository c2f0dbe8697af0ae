/**
 * Sends the upload form with its progress shown. A refusal replaces only the place for refusals, so the chosen file and
 * everything else typed stay. Without this script the form is sent as any other.
 */
import { find, make, need } from "../shared/dom.js";
import { showTimes } from "../shared/times.js";

const form = find("#upload", HTMLFormElement);
/** @param {number} bytes */
const megabytes = (bytes) => (bytes / 1e6).toFixed(1);
/** @type {XMLHttpRequest | null} */
let request = null;

/** @param {number | null} fraction @param {string} sentence */
function say(fraction, sentence) {
  const progress = need("#upload-progress", HTMLElement);
  progress.hidden = false;
  const bar = need("progress", HTMLProgressElement, progress);
  if (fraction === null) bar.removeAttribute("value");
  else bar.value = fraction;
  need("p", HTMLElement, progress).textContent = sentence;
}

/** @param {boolean} isSending */
function offer(isSending) {
  need("#upload-send", HTMLButtonElement).disabled = isSending;
  need("#upload-stop", HTMLButtonElement).hidden = !isSending;
}

function rest() {
  request = null;
  need("#upload-progress", HTMLElement).hidden = true;
  offer(false);
}

const result = () => need("#upload-result", HTMLElement);

/** Show a sentence where refusals stand. @param {string} sentence */
function refuse(sentence) {
  const notice = make("div", { className: "notice notice-serious", role: "alert" });
  notice.append(make("p", { textContent: sentence }));
  result().replaceChildren(notice);
}

/** A refusal comes as the page again, or as a problem where the body was cut short. @param {XMLHttpRequest} answer */
function showRefusal(answer) {
  if ((answer.getResponseHeader("Content-Type") ?? "").includes("json")) {
    refuse(showTimes(JSON.parse(answer.responseText).detail));
    return;
  }
  const page = new DOMParser().parseFromString(answer.responseText, "text/html");
  const told = page.getElementById("upload-result") ?? page.querySelector(".problem .body");
  if (told) result().replaceChildren(...told.childNodes);
  else refuse(`The server answered ${answer.status}; try again.`);
  const recognised = find("#profile", HTMLSelectElement, page)?.value;
  if (recognised) need("#profile", HTMLSelectElement).value = recognised;
}

/** @param {XMLHttpRequest} answer */
function finish(answer) {
  rest();
  scrollTo({ top: 0 });
  if (answer.status === 201) location.assign(answer.getResponseHeader("Location") ?? "/telemetry");
  else if (answer.responseURL.includes("/login")) location.assign("/login?next=/telemetry");
  else showRefusal(answer);
}

/** @param {HTMLFormElement} form @param {HTMLElement | null} submitter */
function upload(form, submitter) {
  const content = new FormData(form, submitter); // before the button that was pressed goes with the refusal it stands in
  result().replaceChildren();
  const sent = (request = new XMLHttpRequest());
  sent.upload.onprogress = ({ loaded, total }) =>
    say(loaded / total, loaded < total ? `${megabytes(loaded)} of ${megabytes(total)} MB sent` : "Sent; reading, extracting and checking");
  sent.upload.onload = () => say(null, "Sent; reading, extracting and checking");
  sent.onload = () => finish(sent);
  sent.onerror = () => {
    rest();
    refuse("The upload was interrupted. The file is still chosen: check the connection and upload it again.");
  };
  sent.onabort = () => {
    rest();
    refuse("The upload was stopped; nothing was stored.");
  };
  sent.open("POST", form.action);
  sent.setRequestHeader("Accept", "text/html");
  sent.setRequestHeader("X-Boresight-Upload", "1");
  say(0, "Sending");
  offer(true);
  sent.send(content);
}

if (form) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    upload(form, event.submitter);
  });
  need("#upload-stop", HTMLButtonElement).addEventListener("click", () => request?.abort());
  addEventListener("beforeunload", (event) => request && event.preventDefault());
}
