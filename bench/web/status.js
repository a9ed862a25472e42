// What the service and the run are doing: state, run with its progress, supervisor and link, and whether any of it is still true.

import { byId, say, show } from "./dom.js";
import { NONE, count, duration, number, unitText } from "./format.js";

/** In words and with a sign of its own shape, so that the colour is not needed to tell them apart. */
const STATES = {
  none: ["○", "CONNECTING"],
  idle: ["○", "IDLE"],
  armed: ["◐", "ARMED"],
  running: ["▶", "RUNNING"],
  waiting: ["◆", "WAITING"],
  following: ["▷", "FOLLOWING"],
  tripped: ["■", "TRIPPED"],
  lost: ["✕", "NO CONNECTION"],
};

/** Shows the service's state. */
export class Status {
  constructor() {
    this.connected = false;
    this.lostSince = performance.now();
    /** @type {any} */
    this.state = null;
    setInterval(() => this.countLost(), 500);
  }

  /** @param {boolean} connected */
  setConnected(connected) {
    if (this.connected && !connected) this.lostSince = performance.now();
    this.connected = connected;
    document.body.classList.toggle("lost", !connected);
    show(byId("lost"), !connected);
    this.countLost();
    this.word();
  }

  /** @private */
  countLost() {
    if (this.connected) return;
    say(byId("lost-for"), `for ${duration((performance.now() - this.lostSince) / 1000)}; trying again`);
  }

  /** The state in one word. @private */
  word() {
    const { service, run } = this.state ?? {};
    const under_way = run && !run.ended;
    /** @type {keyof typeof STATES} */
    let key = service ? service.state : "none";
    if (key !== "tripped" && under_way) key = run.waiting ? "waiting" : key === "running" ? key : "following";
    if (!this.connected && service) key = "lost";
    const [sign, word] = STATES[key] ?? ["?", String(key).toUpperCase()];
    byId("state").dataset.state = key;
    say(byId("state-sign"), sign);
    say(byId("state-word"), word);
    document.title = [word, under_way ? run.name : "", service?.rig ?? "rec-bench"].filter(Boolean).join(" · ");
  }

  /** @param {any} state as of `GET /state` */
  set(state) {
    this.state = state;
    const { service, run, link, last } = state;
    this.word();
    say(byId("rig"), service.rig);
    say(byId("service"), `${service.device} · instance ${service.instance}`);
    byId("service").title = `${service.version}, since ${service.started_utc}`;
    this.showRun(run, last);
    this.showLink(service, run, link);
    show(byId("trip"), service.trip !== null);
    if (service.trip) say(byId("trip-reason"), service.trip.reason);
  }

  /** @private @param {any} run @param {any} last */
  showRun(run, last) {
    const bar = /** @type {HTMLProgressElement} */ (byId("run-progress"));
    if (!run || (run.ended && last)) {
      say(byId("run-name"), last ? `${last.name}: ${last.outcome}` : run ? `${run.name}: ended` : "no run yet");
      say(byId("run-facts"), last ? "last run" : "");
      say(byId("run-time"), "");
      say(byId("run-step"), last?.text ?? "");
      bar.value = 0;
      return;
    }
    say(byId("run-name"), run.name);
    say(byId("run-facts"), [`run ${run.number}`, run.protocol, run.role, run.plane, run.own === false ? "of another process" : ""].filter(Boolean).join(" · "));
    const known = run.duration_s !== null && run.duration_s !== undefined;
    say(byId("run-time"), known ? `${duration(run.time_s)} of ${duration(run.duration_s)} · at most ${duration(run.remaining_s)} left` : duration(run.time_s));
    if (known && run.duration_s > 0) bar.value = Math.min(1, run.time_s / run.duration_s);
    else bar.removeAttribute("value");
    say(byId("run-step"), run.step ? `step ${run.step.index} · ${run.step.text}` : NONE);
    byId("run-step").title = run.step?.text ?? "";
  }

  /** @private @param {any} service @param {any} run @param {any} link */
  showLink(service, run, link) {
    const supervisor = byId("supervisor");
    say(supervisor, run ? (run.trip ? `${run.supervisor}: ${run.trip}` : run.supervisor) : NONE);
    supervisor.className = !run ? "" : run.supervisor === "tripped" ? "bad" : run.supervisor === "ok" ? "good" : "";
    say(byId("heartbeat"), link ? `${link.heartbeat_age_ms.toFixed(1)} ms ago` : NONE);
    say(byId("samples"), count(run?.samples));
    say(byId("missed"), count(run?.missed));
    byId("missed").classList.toggle("bad", (run?.missed ?? 0) > 0);
    say(byId("limits"), limits(service.limits));
  }

  /** @param {number|null} delay_ms from when a sample was due to when it was drawn; null where the clocks don't tell */
  setDelay(delay_ms) {
    say(byId("delay"), delay_ms === null ? NONE : `${delay_ms.toFixed(0)} ms`);
  }
}

/** The rig's limits in a line. @param {Record<string, number|[number, number]|null>|undefined} given */
function limits(given) {
  const parts = Object.entries(given ?? {}).flatMap(([name, limit]) => {
    const unit = { pressure_bar: "bar", angle_deg: "deg", torque_nm: "Nm", velocity_deg_s: "deg/s", voltage_v: "V" }[name];
    if (!unit || limit === null) return [];
    const plain = (/** @type {number} */ n) => number(n, unit).replace(/\.?0+$/, "");
    const text = Array.isArray(limit) ? (limit[0] === -limit[1] ? `±${plain(limit[1])}` : `${plain(limit[0])} … ${plain(limit[1])}`) : `±${plain(limit)}`;
    return [`${text} ${unitText(unit)}`];
  });
  return parts.join(", ") || NONE;
}
