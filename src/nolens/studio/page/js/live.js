// @ts-check
/** The camera's frames: one WebSocket for the page, open while a panel shows it. */

import { get } from "./api.js";
import { pause } from "./format.js";

/**
 * @typedef {object} Head
 * @property {number} number
 * @property {number} fps
 * @property {number} latency_ms
 * @property {number} exposure_s
 * @property {number} gain
 * @property {number | null} iterations
 * @property {string | null} prior of the picture, by the name that --prior has
 * @property {string | null} [trouble] why there is no picture
 * @property {number} dropped
 * @property {number} clipped_fraction
 * @property {Record<string, number[]>} histogram
 * @property {{name: string, type: string, bytes: number}[]} parts
 */
/** @typedef {{head: Head, pictures: Record<string, ImageBitmap>}} Frame */
/** @typedef {{frame?: (frame: Frame) => void, state?: (state: any) => void, link?: (up: boolean) => void}} Viewer */

const STATE_MS = 2000;
const RETRY_MS = [300, 600, 1200, 2500, 5000];

/** @param {ArrayBuffer} message @returns {Promise<Frame>} */
async function unpacked(message) {
  const length = new DataView(message).getUint32(0, true);
  /** @type {Head} */
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, length)));
  /** @type {Record<string, ImageBitmap>} */
  const pictures = {};
  let at = 4 + length;
  for (const part of head.parts) {
    const bytes = new Uint8Array(message, at, part.bytes);
    pictures[part.name] = await createImageBitmap(new Blob([bytes], { type: part.type }));
    at += part.bytes;
  }
  return { head, pictures };
}

class Live {
  constructor() {
    /** @type {Set<Viewer>} */
    this.viewers = new Set();
    /** @type {WebSocket | null} */
    this.socket = null;
    /** @type {Head | null} the newest frame's */
    this.head = null;
    /** @type {any} the newest answer of /api/live */
    this.state = null;
    this.up = false;
    this.failures = 0;
    document.addEventListener("visibilitychange", () => this.follow());
    setInterval(() => { if (this.wanted) this.ask(); }, STATE_MS);
  }

  get wanted() {
    return this.viewers.size > 0 && !document.hidden;
  }

  /** Show frames to a panel until it leaves. @param {Viewer} viewer */
  join(viewer) {
    this.viewers.add(viewer);
    if (this.state) viewer.state?.(this.state);
    this.follow();
    this.ask();
  }

  /** @param {Viewer} viewer */
  leave(viewer) {
    this.viewers.delete(viewer);
    this.follow();
  }

  follow() {
    if (!this.wanted) {
      // One that is still connecting is closed once it is open: browsers call that an error before.
      if (this.socket?.readyState === WebSocket.CONNECTING) return;
      this.socket?.close();
      this.socket = null;
    } else if (this.socket === null) {
      this.connect();
    }
  }

  connect() {
    const address = new URL("api/live/frames", location.href);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    address.hash = "";
    address.search = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.failures = 0;
      if (this.wanted) {
        this.link(true);
        this.ask();
      } else this.follow();
    };
    socket.onmessage = async ({ data }) => {
      try {
        if (data instanceof ArrayBuffer) this.show(await unpacked(data));
      } finally {
        // Only now: what is shown late is not sent at all.
        if (socket.readyState === WebSocket.OPEN) socket.send("ok");
      }
    };
    socket.onclose = async () => {
      if (this.socket !== socket) return;
      this.link(false);
      await pause(RETRY_MS[Math.min(this.failures++, RETRY_MS.length - 1)]);
      if (this.socket === socket) this.socket = null;
      this.follow();
    };
  }

  /** @param {Frame} frame */
  show(frame) {
    this.head = frame.head;
    for (const viewer of this.viewers) viewer.frame?.(frame);
    for (const picture of Object.values(frame.pictures)) picture.close();
  }

  /** @param {boolean} up */
  link(up) {
    this.up = up;
    for (const viewer of this.viewers) viewer.link?.(up);
  }

  /** Settings and errors, which other pages can change too. */
  async ask() {
    try {
      this.tell(await get("api/live"));
    } catch {
      // The socket's own state tells that the studio is away.
    }
  }

  /** @param {any} state */
  tell(state) {
    this.state = state;
    for (const viewer of this.viewers) viewer.state?.(state);
  }

  /** A picture of the webcam to be the scene. @param {Blob} picture @returns {boolean} whether it was sent */
  send(picture) {
    const socket = this.socket;
    if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > 0) return false;
    socket.send(picture);
    return true;
  }

  /** The next frame after the one that is shown. @param {number} wait_ms */
  next(wait_ms = 15000) {
    const before = this.head?.number ?? -1;
    return new Promise((resolve, reject) => {
      /** @type {Viewer} */
      const viewer = {
        frame: ({ head }) => {
          if (head.number === before) return;
          this.leave(viewer);
          clearTimeout(timer);
          resolve(head);
        },
      };
      const timer = setTimeout(() => {
        this.leave(viewer);
        reject(new Error("No new frame came from the camera: is it running, and not frozen?"));
      }, wait_ms);
      this.viewers.add(viewer);
      this.follow();
    });
  }
}

export const live = new Live();

/** Draw a bitmap into a canvas at its own size. @param {HTMLCanvasElement} canvas @param {ImageBitmap | undefined} picture @returns {boolean} whether that is another size */
export function draw(canvas, picture) {
  if (!picture) return false;
  const other = canvas.width !== picture.width || canvas.height !== picture.height;
  if (other) [canvas.width, canvas.height] = [picture.width, picture.height];
  canvas.getContext("2d")?.drawImage(picture, 0, 0);
  return other;
}
