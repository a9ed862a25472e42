// The emergency stop. It asks for nothing, it is never disabled, and it says whether the service took it.

import { byId, say, show } from "./dom.js";

/** An answer that fails to come is asked for again so often: a stop must not be lost to one dropped packet. */
const ATTEMPTS = 3;
const IDLE_TEXT = "trips the rig at once";

/** The button with what became of it. */
export class EmergencyStop {
  /** @param {import("./api.js").Api} api */
  constructor(api) {
    this.api = api;
    this.button = byId("emergency-stop");
    this.note = byId("emergency-note");
    // Taken on the press, not on the release: a finger that slides off has still asked for it. The keyboard has no press of this kind.
    this.button.addEventListener("pointerdown", (event) => event.button === 0 && this.ask());
    this.button.addEventListener("click", (event) => event.detail === 0 && this.ask());
    this.asking = false;
  }

  /** @param {any} state */
  set(state) {
    const control = state.service.control;
    show(this.button, control);
    show(byId("read-only"), !control);
    // What was said of an earlier stop is over once somebody acknowledged it.
    if (!this.asking && this.taken && state.service.state !== "tripped" && performance.now() - this.taken > 2000) {
      this.taken = 0;
      this.tell("", IDLE_TEXT);
    }
  }

  /** @private */
  async ask() {
    if (this.asking) return;
    this.asking = true;
    this.tell("sending", "sending …");
    /** @type {any} */
    let refused = null;
    for (let attempt = 0; attempt < ATTEMPTS; attempt++) {
      try {
        await this.api.post("emergency-stop");
        refused = null;
        break;
      } catch (error) {
        refused = error;
        // The service has spoken: asking again changes nothing.
        if (refused.status > 0 && refused.status < 500) break;
      }
    }
    this.asking = false;
    if (refused) {
      this.tell("refused", `NOT TAKEN: ${refused.error ?? refused}. Use the rig's own stop`);
    } else {
      this.taken = performance.now();
      this.tell("taken", `TAKEN at ${new Date().toTimeString().slice(0, 8)}`);
    }
  }

  /** @private @param {string} outcome @param {string} text */
  tell(outcome, text) {
    this.button.dataset.outcome = outcome;
    say(this.note, text);
    say(byId("emergency-said"), outcome ? `emergency stop: ${text}` : "");
  }
}
