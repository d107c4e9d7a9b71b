// @ts-check
/** Numbers as a person reads them. */

/** A number with so many digits that count. @param {number} value @param {number} [digits] */
export function number(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e6)) {
    const [part, power] = value.toExponential(Math.max(0, digits - 1)).split("e");
    const raised = String(Number(power)).replace(/./g, (each) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(each)] ?? "⁻");
    return `${part === "1.0" || part === "1.00" ? "" : `${part}·`}10${raised}`;
  }
  return Number(value.toPrecision(digits)).toString();
}

/** An exposure time. @param {number} seconds */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds >= 1) return `${seconds.toFixed(2)} s`;
  if (seconds >= 1e-3) return `${(seconds * 1e3).toPrecision(3)} ms`;
  return `${(seconds * 1e6).toPrecision(3)} µs`;
}

/** Time left, coarsely. @param {number} seconds */
export function left(seconds) {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s left`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min left` : `${(seconds / 3600).toFixed(1)} h left`;
}

/** @param {number} fraction @param {number} [digits] */
export const percent = (fraction, digits = 2) => `${number(100 * fraction, digits)} %`;

/** @param {number} millimetres */
export const mm = (millimetres) => `${millimetres.toFixed(3)} mm`;

/** Last part of a path. @param {string} path */
export const baseName = (path) => path.split("/").pop() ?? path;

/** @param {string} path */
export const folderOf = (path) => path.split("/").slice(0, -1).join("/");

/** Calls once, some time after the last of many. @template {any[]} A @param {(...given: A) => void} call @param {number} wait_ms */
export function later(call, wait_ms) {
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  return (/** @type {A} */ ...given) => {
    clearTimeout(timer);
    timer = setTimeout(() => call(...given), wait_ms);
  };
}

/** @param {number} wait_ms */
export const pause = (wait_ms) => new Promise((done) => setTimeout(done, wait_ms));
