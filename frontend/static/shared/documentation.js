// The API's documentation. What is tried with a log-in repeats its token, as every unsafe request must.

const SAFE = ["GET", "HEAD", "OPTIONS"];

/** @returns {Promise<string>} The token of this browser's log-in; empty where nobody is logged in. */
async function token() {
  const answer = await fetch("/api/v1/sessions/current");
  return answer.ok ? ((await answer.json()).csrf_token ?? "") : "";
}

window.SwaggerUIBundle?.({
  url: "/api/v1/openapi.json",
  dom_id: "#documentation",
  docExpansion: "none",
  filter: true,
  tryItOutEnabled: true,
  validatorUrl: null,
  requestInterceptor: async (request) => {
    const method = (request.method ?? "GET").toUpperCase();
    if (!SAFE.includes(method) && !request.headers.Authorization) {
      request.headers["X-CSRF-Token"] = await token();
    }
    return request;
  },
});
