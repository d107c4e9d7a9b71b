// @ts-check
/** How the live picture is reconstructed. */

import { segments, slider } from "./dom.js";
import { later, number } from "./format.js";
import { told } from "./notices.js";

const SEND_MS = 80;
/** @type {Record<string, [number, number]>} τ of the two weighs other things: each has its own ends. */
const ENDS = { admm: [1e-6, 1e-1], wiener: [1e-3, 1e2] };

export class SolverControls {
  /** @param {(given: Record<string, unknown>) => Promise<void>} set */
  constructor(set) {
    const send = later(told(set), SEND_MS);
    this.method = segments("Method", [["wiener", "Wiener"], ["admm", "ADMM"]], "admm",
      told((method) => set({ method })));
    this.tau = slider({
      label: "τ, weight of the prior", min: 1e-6, max: 1e-1, value: 1e-4, log: true,
      text: (value) => number(value, 2), input: (tau) => send({ tau }),
    });
    this.iterations = slider({
      label: "Iterations per frame", min: 1, max: 40, value: 4, step: 1,
      text: String, input: (iterations) => send({ iterations }),
    });
    /** The method whose ends τ has. */
    this.limited = "admm";
    this.elements = [this.method.element, this.tau.element, this.iterations.element];
  }

  /** @param {any} settings */
  follow(settings) {
    if (this.limited !== settings.method) this.tau.limit(...ENDS[settings.method]);
    this.limited = settings.method;
    this.method.set(settings.method);
    if (document.activeElement !== this.tau.input) this.tau.set(settings.tau);
    if (document.activeElement !== this.iterations.input) this.iterations.set(settings.iterations);
    this.iterations.input.disabled = settings.method === "wiener";
  }
}
