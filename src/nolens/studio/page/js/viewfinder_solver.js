// @ts-check
/** How the live picture is reconstructed. */

import { detailSlider } from "./controls.js";
import { segments, slider, tick } from "./dom.js";
import { later } from "./format.js";
import { told } from "./notices.js";

const SEND_MS = 80;

export class SolverControls {
  /** @param {(given: Record<string, unknown>) => Promise<void>} set */
  constructor(set) {
    /** @type {Record<string, unknown>} */
    let waiting = {};
    // One request after the other: a later one could overtake what is on its way.
    let last = Promise.resolve();
    const flush = (/** @type {Record<string, unknown>} */ more = {}) => {
      const changes = waiting;
      waiting = {};
      const sent = last.then(async () => {
        if (Object.keys(changes).length) await set(changes);
        if (Object.keys(more).length) await set(more);
      });
      last = sent.catch(() => {});
      return sent;
    };
    const soon = later(told(() => flush()), SEND_MS);
    const send = (/** @type {Record<string, unknown>} */ change) => {
      Object.assign(waiting, change);
      soon();
    };
    // What is still waiting belongs to the method before.
    this.method = segments("Method", [["wiener", "Wiener"], ["admm", "ADMM"]], "admm",
      told((method) => flush({ method })));
    this.detail = detailSlider((detail) => send({ detail }));
    this.iterations = slider({
      label: "Iterations per frame", min: 1, max: 40, value: 4, step: 1,
      text: String, input: (iterations) => send({ iterations }),
    });
    this.field = tick("PSFs over the field: sharper, and slower", false,
      told((over_field) => flush({ over_field })));
    this.field.element.hidden = true;
    this.trained = tick("Trained network where it keeps 10 frames a second", true,
      told((trained) => flush({ trained })));
    this.elements = [this.method.element, this.detail.element, this.iterations.element,
      this.trained.element, this.field.element];
  }

  /** @param {any} settings */
  follow(settings) {
    this.method.set(settings.method);
    if (document.activeElement !== this.detail.input) this.detail.set(settings.detail);
    if (document.activeElement !== this.iterations.input) this.iterations.set(settings.iterations);
    this.iterations.input.disabled = this.field.box.disabled = this.trained.box.disabled
      = settings.method === "wiener";
    this.trained.box.checked = settings.trained;
    this.field.box.checked = settings.over_field;
  }
}
