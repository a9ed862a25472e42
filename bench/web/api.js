// The service's requests, and the token that its commands need.

const TOKEN = "rec-bench-token";

/** A request that the service refused, or that did not reach it. */
export class Refusal extends Error {
  /**
   * @param {number} status of HTTP; 0 where no answer came
   * @param {string} error what was wrong
   * @param {string} remedy what to do
   */
  constructor(status, error, remedy) {
    super(remedy ? `${error}: ${remedy}` : error);
    this.status = status;
    this.error = error;
    this.remedy = remedy;
  }
}

/** Requests below `api/v1`, beside the page's own address. */
export class Api {
  constructor(base = new URL("api/v1/", document.baseURI)) {
    this.base = base;
    /** @type {string|null} */
    this.token = sessionStorage.getItem(TOKEN);
    this.takeToken();
  }

  /**
   * Takes a token out of the address (`#token=...`): kept for this tab alone, and gone from the address bar and the history, where
   * it would be read over a shoulder.
   */
  takeToken() {
    const given = new URLSearchParams(location.hash.slice(1)).get("token");
    if (given === null) return;
    this.setToken(given);
    history.replaceState(null, "", location.pathname + location.search);
  }

  /** @param {string|null} token null forgets it */
  setToken(token) {
    this.token = token?.trim() || null;
    if (this.token) sessionStorage.setItem(TOKEN, this.token);
    else sessionStorage.removeItem(TOKEN);
  }

  /** The address of the WebSocket. */
  get live() {
    const url = new URL("live", this.base);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    return url.href;
  }

  /**
   * @param {string} path
   * @returns {Promise<any>}
   */
  get(path) {
    return this.request("GET", path);
  }

  /**
   * @param {string} path
   * @param {object} [body]
   * @returns {Promise<any>}
   */
  post(path, body = {}) {
    return this.request("POST", path, body);
  }

  /**
   * @param {string} path
   * @returns {Promise<any>}
   */
  remove(path) {
    return this.request("DELETE", path);
  }

  /**
   * One request; an answer that takes longer than 2 s counts as none.
   * @param {string} method
   * @param {string} path
   * @param {object} [body]
   * @returns {Promise<any>} the answer's JSON
   * @throws {Refusal}
   */
  async request(method, path, body) {
    /** @type {Record<string, string>} */
    const headers = {};
    if (body) headers["Content-Type"] = "application/json";
    if (this.token && method !== "GET") headers.Authorization = `Bearer ${this.token}`;
    let response;
    try {
      response = await fetch(new URL(path, this.base), {
        method, headers, body: body && JSON.stringify(body), cache: "no-store", signal: AbortSignal.timeout(2000),
      });
    } catch {
      throw new Refusal(0, "the service does not answer", "see that it runs and that this machine reaches it");
    }
    const answer = await response.json().catch(() => ({}));
    if (response.ok) return answer;
    throw new Refusal(response.status, answer.error ?? `the service answers ${response.status}`, answer.remedy ?? "");
  }
}
