// The live stream: decoding of its frames, and a connection that is taken up again when it breaks.

/**
 * A channel of the stream, as `hello` names it; `derived`: reckoned by the page.
 * @typedef {{name: string, label: string, unit: string, group: string, derived?: boolean}} Channel
 *
 * Buckets of samples. Arrays are views of the received frame.
 * @typedef {{run: number, time_s: Float64Array, channels: {min: Float32Array, max: Float32Array, last: Float32Array}[]}} Buckets
 */

const BUCKETS = 1;
const HEADER = 16;

/** No state for this long and the values on screen are called old. The service sends one at least every 200 ms. */
export const STALE_MS = 1200;
/** A connection that has been silent for this long is given up: the other end may be gone without a word. */
const GIVEN_UP_MS = 3000;
const FIRST_RETRY_MS = 250;
const LAST_RETRY_MS = 3000;

/**
 * Decodes a binary frame of kind 1.
 * @param {ArrayBuffer} frame
 * @param {number} channelCount as `hello` announced
 * @returns {Buckets|null} null: a kind that this page does not know, left to later versions
 * @throws {Error} where the frame is not what its header says
 */
export function decodeBuckets(frame, channelCount) {
  if (frame.byteLength < HEADER) throw new Error(`expected a frame of ${HEADER} bytes or more, got ${frame.byteLength}`);
  // Typed arrays have the machine's byte order, the frame little-endian: the same on every machine that runs a browser.
  const [kind, run, n, channels] = new Uint32Array(frame, 0, 4);
  if (kind !== BUCKETS) return null;
  if (channels !== channelCount) throw new Error(`expected ${channelCount} channels, got ${channels}`);
  const expected = HEADER + 8 * n + 12 * n * channels;
  if (frame.byteLength < expected) throw new Error(`expected ${expected} bytes for ${n} buckets, got ${frame.byteLength}`);
  const column = (/** @type {number} */ index) => new Float32Array(frame, HEADER + 8 * n + 4 * n * index, n);
  return {
    run,
    time_s: new Float64Array(frame, HEADER, n),
    channels: Array.from({ length: channels }, (_, c) => ({ min: column(3 * c), max: column(3 * c + 1), last: column(3 * c + 2) })),
  };
}

/**
 * What the page does with each message. `connected` says whether values are new: false from {@link STALE_MS} without a state on, or at once
 * when the connection breaks.
 * @typedef {object} Handlers
 * @property {(hello: any) => void} hello
 * @property {(state: any) => void} state
 * @property {(event: any) => void} event
 * @property {(timing: any) => void} timing
 * @property {(begin: any) => void} begin
 * @property {(buckets: Buckets) => void} buckets
 * @property {(connected: boolean) => void} connected
 * @property {(error: unknown) => void} broken a message that can't be read
 */

/** The stream with its reconnects. */
export class Live {
  /**
   * @param {string} url
   * @param {Handlers} handlers
   */
  constructor(url, handlers) {
    this.url = url;
    this.handlers = handlers;
    this.channelCount = 0;
    /** @type {WebSocket|null} */
    this.socket = null;
    this.connected = false;
    this.lastState = -Infinity;
    this.opened = 0;
    this.retry_ms = FIRST_RETRY_MS;
    this.open();
    setInterval(() => this.check(), 100);
    document.addEventListener("visibilitychange", () => this.check());
  }

  /** @private */
  open() {
    this.opened = performance.now();
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (message) => this.receive(socket, message.data);
    socket.onclose = () => this.closed(socket);
    this.socket = socket;
  }

  /**
   * @private
   * @param {WebSocket} socket
   */
  closed(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    this.tell(false);
    setTimeout(() => this.open(), this.retry_ms);
    this.retry_ms = Math.min(LAST_RETRY_MS, this.retry_ms * 1.6);
  }

  /** Compares the age of the newest state with what is told. @private */
  check() {
    const now = performance.now();
    if (now - this.lastState > STALE_MS) this.tell(false);
    const silent = now - Math.max(this.lastState, this.opened);
    if (this.socket && silent > GIVEN_UP_MS) {
      const socket = this.socket;
      socket.onmessage = socket.onclose = null;
      socket.close();
      this.closed(socket);
    }
  }

  /**
   * @private
   * @param {boolean} connected
   */
  tell(connected) {
    if (connected === this.connected) return;
    this.connected = connected;
    this.handlers.connected(connected);
  }

  /**
   * @private
   * @param {WebSocket} socket
   * @param {string|ArrayBuffer} data
   */
  receive(socket, data) {
    if (socket !== this.socket) return;
    try {
      if (typeof data === "string") this.text(JSON.parse(data));
      else this.binary(data);
    } catch (error) {
      this.handlers.broken(error);
    }
  }

  /**
   * @private
   * @param {any} message
   */
  text(message) {
    switch (message.type) {
      case "hello":
        this.channelCount = message.channels.length;
        this.handlers.hello(message);
        break;
      case "state":
        this.lastState = performance.now();
        this.retry_ms = FIRST_RETRY_MS;
        this.handlers.state(message);
        this.tell(true);
        break;
      case "event": this.handlers.event(message); break;
      case "timing": this.handlers.timing(message); break;
      case "begin": this.handlers.begin(message); break;
    }
  }

  /**
   * @private
   * @param {ArrayBuffer} frame
   */
  binary(frame) {
    const buckets = decodeBuckets(frame, this.channelCount);
    if (buckets) this.handlers.buckets(buckets);
  }
}
