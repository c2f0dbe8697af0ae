// Sends the upload form with its progress shown. A refusal replaces only the place for refusals, so the chosen file and
// everything else typed stay. Without this script the form is sent as any other.

const form = document.getElementById("upload");
const result = document.getElementById("upload-result");
const progress = document.getElementById("upload-progress");
const send = document.getElementById("upload-send");
const stop = document.getElementById("upload-stop");
const megabytes = (bytes) => (bytes / 1e6).toFixed(1);
let request = null;

function say(fraction, sentence) {
  progress.hidden = false;
  const bar = progress.querySelector("progress");
  if (fraction === null) bar.removeAttribute("value");
  else bar.value = fraction;
  progress.querySelector("p").textContent = sentence;
}

function rest() {
  request = null;
  progress.hidden = true;
  send.disabled = false;
  stop.hidden = true;
}

/** Show a sentence where refusals stand. */
function refuse(sentence) {
  const notice = document.createElement("div");
  notice.className = "notice notice-serious";
  notice.setAttribute("role", "alert");
  notice.append(Object.assign(document.createElement("p"), { textContent: sentence }));
  result.replaceChildren(notice);
}

/** A refusal comes as the page again, or as a problem where the body was cut short. */
function showRefusal(answer) {
  if ((answer.getResponseHeader("Content-Type") ?? "").includes("json")) {
    refuse(JSON.parse(answer.responseText).detail);
    return;
  }
  const page = new DOMParser().parseFromString(answer.responseText, "text/html");
  const told = page.getElementById("upload-result") ?? page.querySelector(".problem .body");
  if (told) result.replaceChildren(...told.cloneNode(true).childNodes);
  else refuse(`The server answered ${answer.status}; try again.`);
}

function finish(answer) {
  rest();
  scrollTo({ top: 0 });
  if (answer.status === 201) location.assign(answer.getResponseHeader("Location"));
  else if (answer.responseURL.includes("/login")) location.assign("/login?next=/telemetry");
  else showRefusal(answer);
}

function upload(event) {
  event.preventDefault();
  result.replaceChildren();
  request = new XMLHttpRequest();
  request.upload.onprogress = ({ loaded, total }) =>
    say(loaded / total, loaded < total ? `${megabytes(loaded)} of ${megabytes(total)} MB sent` : "Sent; reading and checking");
  request.upload.onload = () => say(null, "Sent; reading and checking");
  request.onload = () => finish(request);
  request.onerror = () => {
    rest();
    refuse("The upload broke off. The file is still chosen: check the link and send it again.");
  };
  request.onabort = () => {
    rest();
    refuse("The upload was stopped; nothing was stored.");
  };
  request.open("POST", form.action);
  request.setRequestHeader("Accept", "text/html");
  request.setRequestHeader("X-Boresight-Upload", "1");
  say(0, "Sending");
  send.disabled = true;
  stop.hidden = false;
  request.send(new FormData(form));
}

if (form) {
  form.addEventListener("submit", upload);
  stop.addEventListener("click", () => request?.abort());
  addEventListener("beforeunload", (event) => request && event.preventDefault());
}
