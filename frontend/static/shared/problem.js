/** Fetching with the server's refusals (application/problem+json) turned into one sentence. */

/** A refusal; `message` is for the person, `status` for the code, `faults` are the places it names. */
export class Problem extends Error {
  constructor(message, status, faults = []) {
    super(message);
    this.status = status;
    this.faults = faults;
  }
}

/** Headers of a request that a page makes by itself: it is no use of the log-in, so an open page alone does not keep it alive. */
export const BACKGROUND = { "X-Boresight-Background": "1" };

async function problemOf(response) {
  let body = {};
  try {
    body = await response.json();
  } catch {
    // a proxy's HTML page: the status says what is known
  }
  const sentence = body.detail || body.title || `The server answered ${response.status}.`;
  const id = body.request_id ? ` (request ${body.request_id})` : "";
  return new Problem(`${typeof sentence === "string" ? sentence : "The server refused the request."}${id}`, response.status, body.errors);
}

/** Send a request and return the answer, or throw a Problem. */
export async function send(url, options = {}) {
  let response;
  try {
    response = await fetch(url, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem("The server cannot be reached. What is shown is the last that arrived.", 0);
  }
  if (!response.ok) throw await problemOf(response);
  return response;
}

export const fetchJson = async (url, options = {}) =>
  (await send(url, { ...options, headers: { Accept: "application/json", ...options.headers } })).json();
