// @ts-check
/** Calibrate: from a point source to a PSF in the camera's folder, step by step. */

import { onDisk, post, upload } from "./api.js";
import { cameraChoice, cameras } from "./choices.js";
import { button, field, figureTable, fill, group, h, setOptions } from "./dom.js";
import { Centring } from "./centring.js";
import { JobForm } from "./controls.js";
import { known, psfFigures, psfPlot } from "./figures.js";
import { folderOf, number } from "./format.js";
import { exposureAdvice } from "./histogram.js";
import { fileLinks, JobView, run } from "./jobs.js";
import { draw, live } from "./live.js";
import { option } from "./names.js";
import { banner, told } from "./notices.js";
import { PsfImport } from "./psf_import.js";
import { LiveValues } from "./pixels.js";
import { Viewer } from "./viewer.js";
import { LightControls } from "./viewfinder_light.js";

const FRAMES = 8;
const DARKS = 4;
/** Frames after a change of scene or exposure that may still be of before. */
const SETTLING = 3;
const MOST_SETTLING = 40;
const SETTLED = 0.03;
const SHORTER = 0.8;
const MOST_SHORTER = 8;
/** Scenes that cannot be shown again: pictures of the visitor's, which are not kept, and those of the calibration. */
const PASSING = ["picture", "webcam", "point", "dark"];
const FIRST = "chart";
/** @type {Record<string, import("./controls.js").Words>} what the page adds to the declarations */
const MORE = {
  mosaic: { words: { "": "As the files say" } },
  stray_light: { words: { auto: "Subtract it where an aperture leaves a dark area", none: "Subtract nothing", floor: "Subtract the darkest light" } },
};

/** A set of frames that is taken or chosen. */
class Take {
  /** @param {string} what @param {number} count @param {(work: () => Promise<void>) => Promise<void>} prepared does the work while the camera sees what it is to see */
  constructor(what, count, prepared) {
    /** @type {string[]} */
    this.paths = [];
    this.prepared = prepared;
    this.count = h("input", { type: "number", min: 1, max: 64, value: count });
    this.taker = button(`Take ${what}`, told(() => this.take()));
    this.file = h("input", { type: "file", multiple: true, onchange: told(() => this.choose()) });
    this.said = h("p", { class: "pale", role: "status" }, "None yet.");
    this.elements = [
      h("div", { class: "row low" }, h("div", { class: "narrow" }, field("How many", this.count)), this.taker),
      h("details", {}, h("summary", {}, "Or use files"), field(`Raw files of ${what}`, this.file)), this.said];
  }

  async take() {
    const wanted = Math.max(1, Number(this.count.value) || 1);
    await this.prepared(async () => {
      /** @type {string[]} */
      const paths = [];
      while (paths.length < wanted) {
        await live.next();
        const { files } = await post("api/live/save", { as: ["raw"], folder: "calibration" });
        paths.push(...files.filter((/** @type {string} */ path) => !path.endsWith(".json")));
        this.said.textContent = `Taking ${paths.length} of ${wanted}…`;
      }
      this.paths = paths;
      this.said.textContent = `${paths.length} taken, in ${await onDisk(folderOf(paths[0]))}.`;
    });
  }

  async choose() {
    const files = [...(this.file.files ?? [])];
    /** @type {string[]} */
    const paths = [];
    for (const each of files) {
      this.said.textContent = `Storing ${each.name}…`;
      paths.push(await upload(each));
    }
    this.paths = paths;
    this.said.textContent = `${paths.length} files chosen.`;
  }

  forget() {
    this.paths = [];
    this.said.textContent = "None yet.";
  }
}

class Calibrate {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.canvas = h("canvas", { width: 480, height: 360, role: "img", "aria-label": "What the sensor measures, live" });
    this.centring = new Centring(this.canvas);
    this.sensor = new Viewer({ title: "Sensor", layers: [this.canvas, this.centring.overlay], note: this.centring.said });
    this.sensor.values = new LiveValues("raw", () => this.sensor.again());
    this.light = new LightControls((given) => this.set(given));
    this.advice = h("p", { class: "pale" });
    this.camera = h("select", { onchange: () => { this.chosen = true; } });
    this.chosen = false;
    this.name = h("input", { type: "text", value: "my-camera", spellcheck: false });
    this.distance = h("input", { type: "text", value: "300mm", spellcheck: false });
    this.pointer = button("Show the simulated camera a point source", told(() => this.show("point")));
    this.frames = new Take("frames", FRAMES, (work) => this.prepared("point", work));
    this.darks = new Take("dark frames", DARKS, (work) => this.prepared("dark", work));
    this.form = new JobForm("calibrate", { without: ["name", "distance"], more: MORE });
    this.maker = button("Make the PSF", told(() => this.make()), { class: "primary" });
    this.job = new JobView({ keep: "calibrate" });
    this.result = h("div", { class: "stage" });
    this.elsewhere = new PsfImport(() => ({ name: this.name.value.trim(), camera: this.camera.value }));
    /** @type {string | null} what the twin looked at before */
    this.before = null;
    this.held = false;
    /** What frames are being taken of. */
    this.seen = "";
    fill(place, h("h1", { class: "unseen" }, "Calibrate"), h("div", { class: "bench watching" },
      h("div", { class: "stage" },
        this.sensor.element),
      h("ol", { class: "side steps" },
        step(group("1 Camera", option("calibrate", "camera", this.camera), option("calibrate", "name", this.name))),
        step(group("2 Point source",
          h("p", {}, "Put a point source (a white LED behind a pinhole of 50 to 100 µm) straight in front of the camera, and darken the room. Move it until its light lies on the cross."),
          option("calibrate", "distance", this.distance), this.pointer)),
        step(group("3 Exposure", ...this.light.elements, this.advice)),
        step(group("4 Frames", h("p", {}, "Their mean has less noise. The exposure is held from here on."), ...this.frames.elements)),
        step(group("5 Dark frames", h("p", {}, "Cover the point source, and leave the room and the exposure as they are."), ...this.darks.elements)),
        step(group("6 PSF", ...this.form.elements, h("div", { class: "row" }, this.maker), this.job.element)),
        step(this.elsewhere.element))), this.result);
    addEventListener("pagehide", told(() => this.back()));
    /** @type {import("./live.js").Viewer} */
    this.viewer = {
      frame: (frame) => this.follow(frame),
      state: (state) => this.settle(state),
      link: (up) => banner(up ? "" : "The connection to the studio is lost. Trying again…", true),
    };
    told(async () => {
      const job = await this.job.again();
      if (job) await this.tell(job);
    })();
  }

  enter() {
    live.join(this.viewer);
    told(async () => {
      const known = await cameras();
      setOptions(this.camera, [...known.map(cameraChoice), { value: "", label: "None: I have no description" }]);
      this.propose();
    })();
  }

  /** Choose the description of the camera that runs, once it and the choices are known, and unless a person chose. */
  propose() {
    const id = live.state?.camera?.id;
    if (this.chosen || ![...this.camera.options].some(({ value }) => value === id)) return;
    this.camera.value = id;
    this.chosen = true;
  }

  leave() {
    live.leave(this.viewer);
    banner("");
    told(() => this.back())();
  }

  /** @param {import("./live.js").Frame} frame */
  follow({ head, pictures }) {
    if (draw(this.canvas, pictures.raw)) this.sensor.lay();
    this.centring.look(this.twin ? live.state?.scene === "point" : null);
    this.light.show(head);
    const { word } = this.light.histogram;
    this.advice.textContent = this.seen === "dark" ? "Dark, as it should be now." : word ? exposureAdvice(word) : "";
  }

  /** @param {any} state */
  settle(state) {
    if (state.settings) this.light.follow(state.settings);
    this.light.limit(state.limits);
    this.pointer.hidden = !this.twin;
    this.propose();
    if (live.up && state.error) banner(state.error, true);
  }

  get twin() {
    return String(live.state?.source ?? "").startsWith("twin");
  }

  /** @param {Record<string, unknown>} given */
  async set(given) {
    this.light.follow(await post("api/live/settings", given));
  }

  /** Let the simulated camera see a point source, or nothing. @param {string} builtin */
  async show(builtin) {
    this.before ??= live.state?.scene ?? null;
    await post("api/live/scene", { builtin });
    await live.ask();
  }

  /** Scene and exposure as they were before. */
  async back() {
    const { before, held } = this;
    [this.before, this.held] = [null, false];
    if (before) await post("api/live/scene", { builtin: PASSING.includes(before) ? FIRST : before });
    if (held) await this.set({ exposure_s: null });
  }

  /** Take frames of what the twin is shown, with an exposure that is held. @param {"point" | "dark"} builtin @param {() => Promise<void>} work */
  async prepared(builtin, work) {
    const buttons = [this.frames.taker, this.darks.taker, this.maker];
    for (const each of buttons) each.disabled = true;
    this.seen = builtin;
    try {
      const { settings } = live.state ?? {};
      if (this.twin) await this.show(builtin);
      if (settings?.frozen) await this.set({ frozen: false });
      for (let frame = 0; frame < SETTLING; frame++) await live.next();
      if (settings?.exposure_s === null) await this.hold();
      await work();
      if (this.twin) await this.show("point");
      await live.ask();
    } finally {
      this.seen = "";
      for (const each of buttons) each.disabled = false;
    }
  }

  /** Wait until the automatic exposure has settled, and keep it, or a shorter one where pixels are clipped. */
  async hold() {
    this.held = true;
    let before = 0;
    for (let frame = 0; frame < MOST_SETTLING; frame++) {
      const { exposure_s } = await live.next();
      if (Math.abs(exposure_s / before - 1) < SETTLED) break;
      before = exposure_s;
    }
    // A scene may have some clipped pixels; a PSF must not.
    for (let less = 0; less < MOST_SHORTER; less++) {
      await this.set({ exposure_s: (live.head?.exposure_s ?? before) * (less ? SHORTER : 1) });
      for (let frame = 0; frame < SETTLING; frame++) await live.next();
      if (!live.head?.clipped_fraction) break;
    }
  }

  async make() {
    if (this.frames.paths.length === 0) throw new Error("There are no frames of the point source yet: take some (step 4), or choose files.");
    this.maker.disabled = true;
    fill(this.result);
    try {
      const job = await this.job.run("calibrate", {
        ...this.form.values(), name: this.name.value.trim(), distance: this.distance.value.trim(), camera: this.camera.value,
        frames: this.frames.paths, dark: this.darks.paths.length ? this.darks.paths : undefined,
      });
      if (job) await this.tell(job);
    } finally {
      this.maker.disabled = false;
    }
  }

  /** The figures of a PSF that was made. @param {import("./jobs.js").Job} job */
  async tell(job) {
    const outputs = job.outputs ?? [];
    const psf = outputs.find((path) => /psf-[^/]*\.tif$/.test(path));
    if (!psf) return;
    const folder = await onDisk(folderOf(psf));
    const again = button("Add another distance", () => this.another());
    const { summary } = job;
    const about = group("PSF of the point source", h("p", {}, "Saved in ", h("code", {}, folder)),
      figureTable([
        ["Frames", String(summary?.frames ?? "–")],
        ["Noise over peak", summary ? `${(100 * Math.max(...summary.noise_over_peak)).toFixed(2)} %` : "–"],
        ["Usable up to", known(summary?.usable_per_mm, (value) => `${number(value)} cycles/mm`)],
      ]), fileLinks(outputs), h("div", { class: "row" }, again));
    fill(this.result, about);
    about.scrollIntoView({ block: "nearest" });
    const measured = await run("measure-psf", { psf });
    fill(this.result, h("div", { class: "three" }, about,
      group("Figures", figureTable(psfFigures(measured.summary), "Figures of the PSF"))), psfPlot(measured));
  }

  /** The same camera, with the light somewhere else. */
  another() {
    this.frames.forget();
    this.darks.forget();
    this.distance.focus();
    this.distance.select();
  }
}

/** @param {HTMLElement} content */
const step = (content) => h("li", {}, content);

/** @param {HTMLElement} place */
export const calibratePanel = (place) => new Calibrate(place);
