// @ts-check
/** The viewfinder: what the sensor sees and the picture that is made of it, live. */

import { onDisk, post } from "./api.js";
import { button, fill, group, h, tick } from "./dom.js";
import { duration, folderOf, number } from "./format.js";
import { fileLinks } from "./jobs.js";
import { draw, live } from "./live.js";
import { banner, told } from "./notices.js";
import { LightControls } from "./viewfinder_light.js";
import { SceneControls } from "./viewfinder_scene.js";
import { LiveValues } from "./pixels.js";
import { Viewer } from "./viewer.js";
import { SolverControls } from "./viewfinder_solver.js";
import { SourceControls } from "./viewfinder_source.js";

/** @param {string} title @param {string} label @param {"raw" | "picture"} what */
function view(title, label, what) {
  const id = `live-${what}`;
  const canvas = h("canvas", { id, width: 480, height: 360, role: "img", "aria-label": label });
  const note = h("span", { class: "pale" });
  const empty = h("p", { hidden: true });
  const viewer = new Viewer({ title, layers: [canvas], over: [empty], note });
  viewer.values = new LiveValues(what, () => viewer.again());
  return { canvas, note, empty, viewer, element: viewer.element };
}

/** @param {string[]} names */
function readout(names) {
  const values = Object.fromEntries(names.map((name) => [name, h("dd", {}, "–")]));
  const element = h("dl", { class: "readout" }, names.map((name) =>
    h("div", {}, h("dt", {}, name), values[name])));
  return { values, element };
}

class Viewfinder {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.raw = view("Sensor", "What the sensor measures, live", "raw");
    this.picture = view("Reconstruction", "The picture reconstructed from it, live", "picture");
    this.picture.element.classList.add("first");
    this.figures = readout(["Frames/s", "Latency", "Dropped", "Exposure", "Gain", "Iterations"]);
    this.frozen = false;
    this.points = 1;
    this.method = this.psfs = "";
    this.trained = false;
    this.freezer = button("Freeze", told(() => this.freeze()), { "aria-pressed": "false", "aria-keyshortcuts": "Space" });
    this.saver = button("Save", told(() => this.save()), { class: "primary", "aria-keyshortcuts": "s" });
    this.png = tick("PNG", true);
    this.tiff = tick("16-bit TIFF", true);
    this.rawFile = tick("Raw", true);
    this.saved = h("div", { class: "saved", role: "status" });
    this.light = new LightControls((given) => this.set(given));
    this.solver = new SolverControls((given) => this.set(given));
    this.scene = new SceneControls();
    this.source = new SourceControls();
    fill(place, h("h1", { class: "unseen" }, "Viewfinder"), h("div", { class: "bench" },
      h("div", { class: "stage" },
        h("div", { class: "pair" }, this.raw.element, this.picture.element),
        this.figures.element),
      h("div", { class: "side" },
        group("Light", ...this.light.elements),
        group("Reconstruction", ...this.solver.elements)),
      h("div", { class: "three below" }, this.scene.element, this.source.element,
        group("Save", h("div", { class: "row" }, this.freezer, this.saver),
          h("div", { class: "row" }, this.png.element, this.tiff.element, this.rawFile.element), this.saved))));
    /** @type {import("./live.js").Viewer} */
    this.viewer = {
      frame: (frame) => this.show(frame),
      state: (state) => this.follow(state),
      link: (up) => banner(up ? "" : "The connection to the studio is lost. Trying again…", true),
    };
  }

  enter() {
    live.join(this.viewer);
  }

  leave() {
    live.leave(this.viewer);
    banner("");
  }

  /** @param {string} key @param {boolean} [control] */
  key(key, control) {
    if (control) return false;
    if (key === " ") this.freezer.click();
    else if (key === "s") this.saver.click();
    else return false;
    return true;
  }

  /** @param {import("./live.js").Frame} frame */
  show({ head, pictures }) {
    for (const [each, picture] of /** @type {[ReturnType<typeof view>, ImageBitmap][]} */ ([[this.raw, pictures.raw], [this.picture, pictures.picture]])) {
      if (draw(each.canvas, picture)) each.viewer.lay();
    }
    this.picture.canvas.hidden = !pictures.picture;
    const { values } = this.figures;
    values["Frames/s"].textContent = this.frozen ? "frozen" : head.fps.toFixed(1);
    values.Latency.textContent = `${Math.round(head.latency_ms)} ms`;
    values.Dropped.textContent = String(head.dropped);
    values.Exposure.textContent = duration(head.exposure_s);
    values.Gain.textContent = number(head.gain, 3);
    values.Iterations.textContent = String(head.iterations ?? "–");
    this.trained = head.prior === "denoiser";
    this.describe();
    this.picture.empty.hidden = Boolean(pictures.picture);
    this.picture.empty.textContent = head.trouble ?? "";
    this.raw.canvas.dataset.number = String(head.number);
    this.light.show(head);
    this.scene.acknowledged();
  }

  /** @param {any} state */
  follow(state) {
    const { settings, error, running } = state;
    if (live.up) {
      const again = button("Start again", told(() => this.source.start()));
      if (error) banner(error, true, again);
      else banner(running ? "" : "Waiting for the camera…", false, again);
    }
    this.raw.note.textContent = state.camera?.name ?? "";
    this.points = state.field_points ?? 1;
    this.solver.field.element.hidden = this.points === 1;
    if (settings) this.settle(settings);
    this.light.limit(state.limits);
    this.scene.follow(state);
    this.source.follow(state);
  }

  /** Say what the picture is by. */
  describe() {
    this.picture.note.textContent = `${this.trained ? "network" : this.method}${this.psfs}`;
  }

  /** @param {any} settings */
  settle(settings) {
    this.frozen = Boolean(settings.frozen);
    this.freezer.setAttribute("aria-pressed", String(this.frozen));
    this.freezer.textContent = this.frozen ? "Go on" : "Freeze";
    if (this.frozen) this.figures.values["Frames/s"].textContent = "frozen";
    const over = settings.over_field && settings.method !== "wiener";
    const psfs = this.points > 1 ? `, ${over ? "" : "mean of "}${this.points} PSFs${over ? " over the field" : ""}` : "";
    this.method = settings.method === "wiener" ? "Wiener" : "ADMM";
    this.psfs = psfs;
    this.describe();
    this.light.follow(settings);
    this.solver.follow(settings);
  }

  /** Change settings of the camera or the solver. @param {Record<string, unknown>} given */
  async set(given) {
    this.settle(await post("api/live/settings", given));
  }

  async freeze() {
    await this.set({ frozen: !this.frozen });
  }

  async save() {
    const chosen = /** @type {[string, {box: HTMLInputElement}][]} */ (
      [["png", this.png], ["tiff", this.tiff], ["raw", this.rawFile]]);
    const as = chosen.filter(([, { box }]) => box.checked).map(([name]) => name);
    if (as.length === 0) throw new Error("Nothing is selected to save: tick PNG, 16-bit TIFF or Raw.");
    this.saver.disabled = true;
    try {
      const { files } = await post("api/live/save", { as });
      const folder = await onDisk(folderOf(files[0]));
      fill(this.saved, h("p", {}, "Saved in ", h("code", {}, folder)), fileLinks(files));
    } finally {
      this.saver.disabled = false;
    }
  }
}

/** @param {HTMLElement} place */
export const viewfinderPanel = (place) => new Viewfinder(place);
