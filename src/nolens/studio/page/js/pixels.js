// @ts-check
/** Values of the pixels of a file: radiance or counts, and the angle where the camera is known. */

import { ApiError, get } from "./api.js";
import { number, pause } from "./format.js";

/**
 * @typedef {object} Head
 * @property {number} width
 * @property {number} height
 * @property {string[]} channels
 * @property {string | null} mosaic colours of the 2×2 superpixel, row by row
 * @property {"radiance" | "counts" | "of white"} unit
 * @property {number[]} offset
 * @property {number[]} step a value is offset + step × number, of its channel
 * @property {boolean} clipped whether the largest number stands for all that is brighter
 * @property {{axis: [number, number], step: number, tangents: number[]} | null} angles
 */

const MOST = 65535;
const LIVE_MS = 150;
/** Channels of which all are told: those of colours, and of polarisation. */
const FEW = 5;

export class PixelValues {
  /** @param {Head} head @param {Uint16Array} numbers */
  constructor(head, numbers) {
    this.head = head;
    this.numbers = numbers;
  }

  /** @param {string} path @param {string} [camera] */
  static async of(path, camera) {
    const query = new URLSearchParams({ path, ...(camera ? { camera } : {}) });
    const answer = await fetch(`api/jobs/pixels?${query}`);
    if (!answer.ok) throw new ApiError(answer.status, (await answer.json()).detail);
    const message = await answer.arrayBuffer();
    const length = new DataView(message).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, length)));
    return new PixelValues(head, new Uint16Array(message.slice(4 + length)));
  }

  /** What a place of the picture holds, as text. @param {number} across @param {number} down fractions of its width and height */
  at(across, down) {
    const { channels, unit } = this.head;
    const { x, y, counts, values } = this.of(across, down);
    const told = channels.map((name, channel) => `${this.colour(name, x, y)}${this.value(counts[channel], channel)}`);
    const text = channels.length > FEW ? `most at ${told[values.indexOf(Math.max(...values))]}` : told.join(", ");
    return [`x ${x}, y ${y}`, `${unit} ${text}`, this.angle(x, y)].filter(Boolean).join(" · ");
  }

  /** The largest value that any channel can have. */
  get most() {
    const { offset, step } = this.head;
    return Math.max(...offset.map((each, channel) => each + step[channel] * MOST));
  }

  /** The pixel at a place, and what its channels hold. @param {number} across @param {number} down fractions of its width and height */
  of(across, down) {
    const { width, height, channels, offset, step } = this.head;
    const [x, y] = [Math.floor(across * width), Math.floor(down * height)];
    const first = (y * width + x) * channels.length;
    const counts = [...this.numbers.subarray(first, first + channels.length)];
    return { x, y, counts, values: counts.map((count, channel) => offset[channel] + step[channel] * count) };
  }

  /** @param {string} name @param {number} x @param {number} y */
  colour(name, x, y) {
    const { channels, mosaic } = this.head;
    if (mosaic) return `${mosaic[2 * (y % 2) + (x % 2)]} `;
    return channels.length > 1 ? `${name} ` : "";
  }

  /** @param {number} count @param {number} channel */
  value(count, channel) {
    const { clipped, unit } = this.head;
    const [offset, step] = [this.head.offset[channel], this.head.step[channel]];
    if (unit === "counts" && step === 1) return String(count);
    return `${clipped && count === MOST ? "≥ " : ""}${number(offset + step * count)}`;
  }

  /** Field angle of a pixel, to the right and up. @param {number} x @param {number} y */
  angle(x, y) {
    const { angles } = this.head;
    if (!angles) return "";
    const [right, up] = [x - angles.axis[0], angles.axis[1] - y];
    const distance = Math.hypot(right, up);
    const place = Math.min(distance / angles.step, angles.tangents.length - 1);
    const [low, high] = [Math.floor(place), Math.ceil(place)];
    const tangent = angles.tangents[low] + (place - low) * (angles.tangents[high] - angles.tangents[low]);
    const degrees = (/** @type {number} */ part) => (Math.atan(distance ? (tangent * part) / distance : 0) * 180) / Math.PI;
    const side = (/** @type {number} */ part, /** @type {string} */ one, /** @type {string} */ other) =>
      `${Math.abs(degrees(part)).toFixed(1)}° ${part < 0 ? other : one}`;
    return `${side(right, "right", "left")}, ${side(up, "up", "down")}`;
  }
}

/** Values that are fetched when they are first asked for. */
export class LazyValues {
  /** @param {() => Promise<PixelValues>} fetched @param {() => void} come is called when they have come */
  constructor(fetched, come) {
    this.fetched = fetched;
    this.come = come;
    /** @type {PixelValues | null} */
    this.values = null;
    /** @type {Promise<PixelValues> | null} */
    this.coming = null;
    this.refused = "";
  }

  /** All of them. */
  get() {
    if (!this.coming) {
      this.coming = this.fetched();
      this.coming.then((values) => { this.values = values; }, (error) => { this.refused = error.message; }).then(this.come);
    }
    return this.coming;
  }

  /** @param {number} across @param {number} down */
  at(across, down) {
    if (this.values) return this.values.at(across, down);
    this.get();
    return this.refused || "Reading the values…";
  }
}

/** Values of the frame that the live view shows: asked for again and again while the pointer rests on it. */
export class LiveValues {
  /** @param {"raw" | "picture"} of @param {() => void} come is called when there is another value */
  constructor(of, come) {
    this.of = of;
    this.come = come;
    this.text = "";
    this.asking = false;
  }

  /** @param {number} across @param {number} down */
  at(across, down) {
    if (!this.asking) {
      this.asking = true;
      get(`api/live/pixel?of=${this.of}&across=${across}&down=${down}`).then(({ x, y, unit, values }) => {
        const parts = Object.entries(values).map(([name, value]) => `${name === "grey" ? "" : `${name} `}${unit === "counts" ? value : number(value)}`);
        this.text = `x ${x}, y ${y} · ${unit} ${parts.join(" ")}`;
      }, (error) => { this.text = error.message; }).then(async () => {
        await pause(LIVE_MS);
        this.asking = false;
        this.come();
      });
    }
    return this.text;
  }
}
