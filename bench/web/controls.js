// Commands: arm, queue, stop, acknowledge, confirm. What may be done now is what the service's state says; the service judges it again.

import { byId, input, make, numberIn, say, show } from "./dom.js";
import { duration } from "./format.js";

/** A new request is not answered by a press that was meant for the one before it. */
const CONFIRM_GUARD_MS = 300;

/** The forms, and what the service answered. */
export class Controls {
  /** @param {import("./api.js").Api} api */
  constructor(api) {
    this.api = api;
    this.connected = false;
    /** @type {any} */
    this.state = null;
    /** @type {any[]} */
    this.profiles = [];
    this.request = "";
    this.asked = 0;
    this.queued = "";

    const click = (/** @type {string} */ id, /** @type {() => Promise<any>} */ action) => {
      byId(id).onclick = () => this.carryOut(action);
    };
    click("arm", () => this.api.post("arm", { for_s: Number(input("arm-for").value) }));
    click("disarm", () => this.api.post("disarm"));
    click("stop", () => this.api.post("stop"));
    click("acknowledge", () => this.api.post("acknowledge"));
    byId("profile").onchange = () => this.describe();
    this.form("queue-form", () => this.carryOut(() => this.enqueue()));
    this.form("confirm-form", () => this.confirm());
    this.form("token-form", () => {
      this.api.setToken(input("token").value);
      input("token").value = "";
      say(byId("control-said"), "");
      this.allow();
    });
  }

  /** @private @param {string} id @param {() => void} action */
  form(id, action) {
    byId(id).addEventListener("submit", (event) => {
      event.preventDefault();
      action();
    });
  }

  /** @param {boolean} connected */
  setConnected(connected) {
    this.connected = connected;
    this.allow();
    if (connected && this.profiles.length === 0) this.loadProfiles();
  }

  /** @param {any} state */
  set(state) {
    this.state = state;
    const { service, run, queue } = state;
    const armed = service.armed_left_s !== null;
    say(byId("armed"), armed ? `armed, ${duration(service.armed_left_s)} left` : "not armed");
    say(byId("arm"), armed ? "Extend" : "Arm");
    show(byId("disarm"), armed);
    say(byId("enqueue"), service.state === "armed" && queue.length === 0 ? "Start" : "Add to queue");
    this.showQueue(queue);
    this.showRequest(run && !run.ended ? run.waiting : null);
    this.allow();
  }

  /** Shows what may be done and disables what may not. @private */
  allow() {
    const control = this.state?.service.control ?? false;
    const known = this.state !== null;
    show(byId("control-read-only"), known && !control);
    show(byId("token-form"), control && !this.api.token);
    show(byId("controls"), control && this.api.token !== null);
    show(byId("stop-set"), control);
    const may = control && this.connected && this.api.token !== null;
    for (const set of document.querySelectorAll("fieldset.control, form.control fieldset")) {
      /** @type {HTMLFieldSetElement} */ (set).disabled = !may;
    }
    for (const form of document.querySelectorAll("form.control")) show(/** @type {HTMLElement} */ (form), control);
    show(byId("acknowledge"), control);
  }

  /**
   * Carries a command out and says what is wrong with it.
   * @private
   * @param {() => Promise<any>} action
   * @param {string} [where] element that says it
   */
  async carryOut(action, where = "control-said") {
    const said = byId(where);
    say(said, "");
    try {
      await action();
    } catch (error) {
      const refusal = /** @type {import("./api.js").Refusal} */ (error);
      said.className = "bad";
      say(said, refusal.message);
      if (refusal.status === 401) {
        this.api.setToken(null);
        this.allow();
      }
    }
  }

  /** @private */
  async loadProfiles() {
    try {
      this.profiles = await this.api.get("profiles");
    } catch {
      // Asked for again at the next connection.
      return;
    }
    const groups = new Map();
    for (const profile of this.profiles) {
      const group = groups.get(profile.protocol) ?? make("optgroup");
      group.label = profile.protocol;
      groups.set(profile.protocol, group);
      const option = /** @type {HTMLOptionElement} */ (make("option", "", `${profile.name}  (${duration(profile.duration_s)}, ${profile.role})`));
      option.value = profile.name;
      group.append(option);
    }
    byId("profile").replaceChildren(...groups.values());
    this.describe();
  }

  /** @private */
  describe() {
    const chosen = this.profiles.find((profile) => profile.name === input("profile").value);
    say(byId("profile-title"), chosen?.title ?? "");
  }

  /** @private */
  async enqueue() {
    const seed = numberIn("seed");
    await this.api.post("queue", { profile: input("profile").value, ...(seed === null ? {} : { seed }) });
    if (this.state?.service.state === "idle") {
      const said = byId("control-said");
      said.className = "";
      say(said, "Queued. It starts once the service is armed.");
    }
  }

  /** @private @param {{id: number, profile: string, seed: number|null}[]} queue */
  showQueue(queue) {
    const now = JSON.stringify(queue);
    if (now === this.queued) return;
    this.queued = now;
    byId("queue").replaceChildren(...queue.map(({ id, profile, seed }) => {
      const item = make("li");
      item.append(make("span", "grow", seed === null ? profile : `${profile}, seed ${seed}`));
      const remove = make("button", "", "Remove");
      remove.setAttribute("type", "button");
      remove.setAttribute("aria-label", `remove ${profile} from the queue`);
      remove.onclick = () => this.carryOut(() => this.api.remove(`queue/${id}`));
      item.append(remove);
      return item;
    }));
  }

  /** @private @param {{request: number, text: string, amount: string|null}|null} waiting */
  showRequest(waiting) {
    show(byId("confirm"), waiting !== null);
    const request = waiting ? `${waiting.request} ${waiting.text}` : "";
    if (request === this.request) return;
    this.request = request;
    this.asked = performance.now();
    say(byId("confirm-answer"), "");
    if (!waiting) return;
    say(byId("confirm-text"), waiting.text);
    show(byId("confirm-amount"), waiting.amount === "volume_ml");
    input("confirm-volume").value = "";
  }

  /** @private */
  confirm() {
    const waiting = this.state?.run?.waiting;
    if (!waiting || performance.now() - this.asked < CONFIRM_GUARD_MS) return;
    const body = { request: waiting.request, ...(waiting.amount === "volume_ml" ? { volume_ml: numberIn("confirm-volume") } : {}) };
    if (body.volume_ml === null) delete body.volume_ml;
    this.carryOut(() => this.api.post("confirm", body), "confirm-answer");
  }
}
