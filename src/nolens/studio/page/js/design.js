// @ts-check
/** Design: the layers of a camera, and what becomes of its PSF when they change. */

import { fileUrl } from "./api.js";
import { cameras } from "./choices.js";
import { JobForm } from "./controls.js";
import { button, figureTable, fill, group, h, setOptions, slider } from "./dom.js";
import { later, mm, number } from "./format.js";
import { cancel, fileLinks, follow, JobView, start } from "./jobs.js";
import { label, option } from "./names.js";
import { told } from "./notices.js";
import { curve, noCurve } from "./plots.js";
import { blur } from "./rays.js";
import { isAir, layerClass, noDrawing, stackDrawing } from "./stack_drawing.js";

const WAIT_MS = 250;
const ANGLE_DEG = 20;
const MOST_TIMES = 2;
const FIRST = "paper";

class Design {
  /** @param {HTMLElement} place */
  constructor(place) {
    /** @type {any} the newest look */
    this.look = null;
    /** @type {Record<string, number>} thickness in mm that was chosen, by layer */
    this.chosen = {};
    /** @type {Map<string, ReturnType<typeof slider>>} */
    this.sliders = new Map();
    this.asked = 0;
    this.running = "";
    this.camera = h("select", { onchange: () => this.begin() });
    this.note = h("p", { class: "pale" });
    this.layers = h("div", { class: "stage" });
    this.best = button("Set to the best focus", () => this.setBest(), { disabled: true });
    this.angle = slider({ label: "Field angle of the oblique rays", min: 0, max: 50, value: ANGLE_DEG, step: 1,
      text: (value) => `${value}°`, input: () => this.draw() });
    this.drawing = h("div", { class: "drawing" }, noDrawing(), h("small", {}, "…"));
    this.figures = h("div", {});
    this.psf = h("img", { alt: "Point spread function" });
    this.psfNote = h("span", {});
    this.autocorrelation = h("div", {}, noCurve());
    this.magnitude = h("div", {}, noCurve());
    this.state = h("p", { class: "job-text", role: "status" });
    this.form = new JobForm("fabricate", { without: ["thickness"] });
    this.job = new JobView();
    this.outputs = h("div", {});
    this.maker = button("Make the files", told(() => this.fabricate()), { class: "primary" });
    this.redraw = later(told(() => this.ask()), WAIT_MS);
    fill(place, h("h1", { class: "unseen" }, "Design"), h("div", { class: "bench left" },
      h("div", { class: "side" },
        group("Camera", option("fabricate", "camera", this.camera), this.note),
        group(label("fabricate", "thickness"), this.layers, this.best, this.angle.element)),
      h("div", { class: "stage" },
        h("div", { class: "drawn" },
          h("section", { class: "group", "aria-label": "Layers to scale" }, this.drawing),
          group("Figures", this.figures, this.state)),
        h("div", { class: "three" },
          group("Point spread function", h("figure", { class: "view" }, h("div", { class: "frame square" }, this.psf),
            h("figcaption", {}, h("b", {}, "PSF"), this.psfNote))),
          group("Autocorrelation", this.autocorrelation),
          group("Spectral magnitude", this.magnitude)),
        group("Fabrication", h("p", { class: "pale" }, "Frame, mask and process sheet of the camera as it is set here."),
          h("div", { class: "three spread" }, this.form.elements), h("div", { class: "row" }, this.maker), this.job.element, this.outputs))));
  }

  enter() {
    told(() => this.list())();
  }

  async list() {
    const all = await cameras();
    const before = this.camera.value;
    const first = before === "" && all.some(({ id }) => id === FIRST);
    setOptions(this.camera, all.map(({ id, name }) => ({ value: id, label: id.includes("/") ? id : name })));
    this.notes = new Map(all.map(({ id, note, trouble }) => [id, trouble ?? note]));
    if (first) this.camera.value = FIRST;
    if (this.camera.value !== before) this.begin();
  }

  /** Begin with a camera as it is described. */
  begin() {
    this.chosen = {};
    this.look = null;
    this.sliders.clear();
    this.note.textContent = this.notes?.get(this.camera.value) ?? "";
    told(() => this.ask())();
  }

  get thickness() {
    const entries = Object.entries(this.chosen).map(([name, value]) => [name, `${value.toFixed(4)}mm`]);
    return entries.length ? Object.fromEntries(entries) : undefined;
  }

  /** Look at the camera as it is set; an older look that is still in work is given up. */
  async ask() {
    const asked = ++this.asked;
    this.state.textContent = "Computing the PSF…";
    if (this.running) cancel(this.running).catch(() => {}); // It may have ended meanwhile.
    const id = await start("design-look", { camera: this.camera.value, thickness: this.thickness });
    this.running = id;
    const job = await follow(id, ({ status }) => {
      if (asked === this.asked && status === "queued") this.state.textContent = "Waiting for the job before it…";
    });
    if (asked !== this.asked) return;
    this.running = "";
    if (job?.status !== "done") {
      this.state.textContent = "";
      throw new Error(job?.error ?? "The PSF could not be computed.");
    }
    this.state.textContent = "";
    this.show(job.summary, (job.outputs ?? []).find((path) => path.endsWith(".png")));
  }

  /** @param {any} look @param {string} [psf] path of its picture */
  show(look, psf) {
    const first = this.look === null;
    this.look = look;
    if (first) this.makeSliders();
    this.best.disabled = !(look.best_thickness_mm > 0);
    this.draw();
    if (psf) {
      this.psf.src = fileUrl(psf);
      this.psfNote.textContent = `${number(look.pixel_um)} µm per pixel`;
    }
    fill(this.autocorrelation, curve({ x: look.autocorrelation.um, y: look.autocorrelation.value, from: 0,
      xLabel: "shift / µm", yLabel: "autocorrelation", title: "Autocorrelation of the PSF by shift" }));
    fill(this.magnitude, curve({ x: look.magnitude.per_mm, y: look.magnitude.value, from: 0,
      xLabel: "cycles per mm", yLabel: "spectral magnitude", title: "Spectral magnitude by frequency" }));
    this.tell();
  }

  makeSliders() {
    fill(this.layers, this.look.layers.map((/** @type {any} */ layer, /** @type {number} */ place) => {
      const made = slider({ label: `${layer.name} · ${layer.material}`, min: layer.thickness_mm / 10,
        max: layer.thickness_mm * MOST_TIMES, value: layer.thickness_mm, step: layer.thickness_mm / 500, text: mm,
        input: (value) => this.set(layer.name, value) });
      this.sliders.set(layer.name, made);
      made.element.prepend(h("span", { class: `chip ${layerClass(place, isAir(layer.index))}`, "aria-hidden": "true" }));
      return made.element;
    }));
  }

  /** @param {string} name @param {number} value */
  set(name, value) {
    this.chosen[name] = value;
    const layer = this.look.layers.find((/** @type {any} */ each) => each.name === name);
    layer.thickness_mm = value;
    this.draw();
    this.redraw();
  }

  setBest() {
    const layer = this.look.layers[this.look.mask_layer ?? this.look.mask_surface];
    this.set(layer.name, this.look.best_thickness_mm);
    this.sliders.get(layer.name)?.set(this.look.best_thickness_mm);
  }

  draw() {
    if (this.look === null) return;
    const caption = this.look.pitch_um ? "Lenslets' heights are enlarged; all else is to scale."
      : "To scale. The mask has no lenslets, so only chief rays are drawn.";
    fill(this.drawing, stackDrawing(this.look, this.angle.value()), h("small", {}, caption));
  }

  tell() {
    const { look } = this;
    const layer = look.layers[look.mask_layer ?? look.mask_surface];
    const given = (/** @type {number | null | undefined} */ value, /** @type {(v: number) => string} */ text) =>
      (typeof value === "number" ? text(value) : "–");
    const spread = look.pitch_um && look.radius_mm
      ? blur({ layers: look.layers, mask: look.mask_surface, radius_mm: look.radius_mm }, look.pitch_um / 1000, 0) * 1000 : null;
    fill(this.figures, figureTable([
      [`Best thickness of the ${layer.name}`, given(look.best_thickness_mm, mm)],
      ["It is off by", given(look.best_thickness_mm && layer.thickness_mm - look.best_thickness_mm, (value) => `${value > 0 ? "+" : ""}${value.toFixed(3)} mm`)],
      ["Depth of focus", given(look.depth_of_focus_mm, mm)],
      ["Numerical aperture", given(look.aperture, (value) => number(value))],
      ["Spot of a lenslet, by rays", given(spread, (value) => `${number(value, 2)} µm`)],
      ["Line width (FWHM)", given(look.fwhm_um, (value) => `${number(value)} µm`)],
      ["Reduced thickness, mask to sensor", given(look.reduced_mm, mm)],
    ], "Figures of the camera"));
  }

  async fabricate() {
    this.maker.disabled = true;
    fill(this.outputs);
    try {
      const job = await this.job.run("fabricate", { ...this.form.values(), camera: this.camera.value, thickness: this.thickness });
      if (job) fill(this.outputs, fileLinks(job.outputs ?? []));
    } finally {
      this.maker.disabled = false;
    }
  }
}

/** @param {HTMLElement} place */
export const designPanel = (place) => new Design(place);
