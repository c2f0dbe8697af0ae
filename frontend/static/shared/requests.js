/** Asking the server, its refusals (application/problem+json) turned into one sentence. */
import { showTimes } from "./times.js";

/** A refusal; `message` is for the person, `status` for the code. */
export class Problem extends Error {
  /** @param {string} message @param {number} status */
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/** Headers of a request that a page makes by itself: it is no use of the log-in, so an open page alone does not keep it alive. */
export const BACKGROUND = { "X-Boresight-Background": "1" };

/** What to say of something that was thrown. @param {unknown} error */
export const describeError = (error) => (error instanceof Error ? error.message : String(error));

/** @param {Response} response @returns {Promise<Problem>} */
async function readProblem(response) {
  /** @type {{ detail?: unknown, title?: string, request_id?: string }} */
  let body = {};
  try {
    body = await response.json();
  } catch {
    // a proxy's HTML page: the status says what is known
  }
  const sentence = body.detail || body.title || `The server answered ${response.status}.`;
  const id = body.request_id ? ` (request ${body.request_id})` : "";
  return new Problem(`${typeof sentence === "string" ? showTimes(sentence) : "The server refused the request."}${id}`, response.status);
}

/** Send a request and return the answer, or throw a Problem. @param {string} url @param {RequestInit} [options] */
export async function send(url, options = {}) {
  let response;
  try {
    response = await fetch(url, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new Problem("The server cannot be reached. The page shows the last data that arrived.", 0);
  }
  if (!response.ok) throw await readProblem(response);
  return response;
}

/** @param {string} url @param {Record<string, string>} [headers] */
export const fetchJson = async (url, headers = {}) => (await send(url, { headers: { Accept: "application/json", ...headers } })).json();

/** Read a page as a document. @param {Response} response */
export const parsePage = async (response) => new DOMParser().parseFromString(await response.text(), "text/html");

/** Fetch a page, or a piece of one, by itself; null where the log-in has ended, which link-state.js tells. @param {string} [url] */
export async function fetchPage(url = location.href) {
  const answer = await send(url, { headers: { Accept: "text/html", ...BACKGROUND } });
  return answer.redirected ? null : parsePage(answer);
}
