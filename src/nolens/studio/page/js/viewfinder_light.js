// @ts-check
/** Exposure, gain, and the histogram that says whether they fit. */

import { slider, tick } from "./dom.js";
import { duration, later, number } from "./format.js";
import { Histogram } from "./histogram.js";
import { told } from "./notices.js";

const SEND_MS = 80;
const AT_FIRST = { exposure_s: [1e-5, 10], gain: [1, 16] };

export class LightControls {
  /** @param {(given: Record<string, unknown>) => Promise<void>} set */
  constructor(set) {
    const send = later(told(set), SEND_MS);
    this.histogram = new Histogram();
    this.automatic = tick("Automatic exposure", true, told(async (on) => {
      await set({ exposure_s: on ? null : this.exposure.value() });
    }));
    this.exposure = slider({
      label: "Exposure", min: AT_FIRST.exposure_s[0], max: AT_FIRST.exposure_s[1], value: 0.02, log: true,
      text: duration,
      input: (exposure_s) => {
        this.automatic.box.checked = false;
        send({ exposure_s });
      },
    });
    this.gain = slider({
      label: "Gain", min: AT_FIRST.gain[0], max: AT_FIRST.gain[1], value: 1, log: true,
      text: (value) => `× ${number(value, 3)}`, input: (gain) => send({ gain }),
    });
    this.limits = "";
    this.elements = [this.histogram.element, this.automatic.element, this.exposure.element, this.gain.element];
  }

  /** @param {import("./live.js").Head} head */
  show(head) {
    this.histogram.show(head.histogram, head.clipped_fraction);
    if (this.automatic.box.checked) this.exposure.set(head.exposure_s);
  }

  /** @param {any} settings */
  follow(settings) {
    this.automatic.box.checked = settings.exposure_s === null;
    if (settings.exposure_s !== null && document.activeElement !== this.exposure.input) {
      this.exposure.set(settings.exposure_s);
    }
    if (document.activeElement !== this.gain.input) this.gain.set(settings.gain ?? 1);
  }

  /** What the camera can do; null where nothing can be set. @param {{exposure_s: number[], gain: number[]} | null} limits */
  limit(limits) {
    const told = JSON.stringify(limits);
    if (told === this.limits) return;
    this.limits = told;
    for (const { input } of [this.exposure, this.gain]) input.disabled = limits === null;
    this.automatic.box.disabled = limits === null;
    if (!limits) return;
    this.exposure.limit(limits.exposure_s[0], limits.exposure_s[1]);
    this.gain.limit(limits.gain[0], limits.gain[1]);
    this.gain.input.disabled = limits.gain[0] === limits.gain[1];
  }
}
