// Frames of the live stream for tests, written by the document's table and not by the page's own code.

/**
 * A frame of kind 1.
 * @param {number} run
 * @param {number[]} time_s start of each bucket
 * @param {{min: number[], max: number[], last: number[]}[]} channels
 * @returns {ArrayBuffer}
 */
export function frame(run, time_s, channels) {
  const bytes = new ArrayBuffer(16 + 8 * time_s.length + 12 * time_s.length * channels.length);
  const view = new DataView(bytes);
  [1, run, time_s.length, channels.length].forEach((word, i) => view.setUint32(4 * i, word, true));
  let at = 16;
  for (const t of time_s) {
    view.setFloat64(at, t, true);
    at += 8;
  }
  for (const { min, max, last } of channels) {
    for (const value of [...min, ...max, ...last]) {
      view.setFloat32(at, value, true);
      at += 4;
    }
  }
  return bytes;
}
