// @ts-check
/** Photograph: from a raw file to a picture that is kept. */

import { fileUrl, upload } from "./api.js";
import { calibratedCameras, fieldPsfChoices, filesBy, offerFiles, psfChoices, psfOf } from "./choices.js";
import { Compare } from "./compare.js";
import { JobForm } from "./controls.js";
import { Depths } from "./depths.js";
import { button, field, filePicker, fill, group, h, segments, setOptions } from "./dom.js";
import { baseName, folderOf, percent } from "./format.js";
import { filesOf, Gallery } from "./gallery.js";
import { fileLinks, JobView, run } from "./jobs.js";
import { live } from "./live.js";
import { option } from "./names.js";
import { told } from "./notices.js";
import { curve, noCurve } from "./plots.js";
import { mainFigures, recordOf, RecordView, settingsOf } from "./record.js";
import { MORE, READING, ReconstructionOptions } from "./reconstruction.js";
import { LazyValues, PixelValues } from "./pixels.js";
import { Spectrum } from "./spectrum.js";
import { Strip } from "./strip.js";
import { Tone } from "./tone.js";
import { Video } from "./video.js";
import { Viewer } from "./viewer.js";

/** @typedef {import("./jobs.js").Job} Job */

/** A file that may be a raw frame: also pictures that were brought to be used as one. @param {import("./choices.js").Entry} entry */
const raw = ({ kind, name, path }) => kind === "raw" || (path.includes("/uploads/") && /\.png$/i.test(name));
/** A file that may be a PSF: one of ours is no raw frame. @param {import("./choices.js").Entry} entry */
const psfFile = (entry) => raw(entry) || (entry.kind === "picture" && /\.tiff?$/i.test(entry.name));
/** A file that may hold weights of a prior. @param {import("./choices.js").Entry} entry */
const weightsFile = ({ name }) => /(?<!\.state)\.npz$/i.test(name);
const NAMED_PSF = /psf|point/i;

class Photograph {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.place = place;
    this.tone = new Tone();
    this.spectrum = new Spectrum(this.tone.viewer);
    this.video = new Video(() => this.play(false));
    this.compare = new Compare();
    this.depths = new Depths();
    this.raw = h("select", { onchange: told(() => this.look()) });
    this.preview = h("img", { alt: "Preview of the raw file", hidden: true });
    this.previewNote = h("span", { class: "pale", role: "status" });
    this.previewer = new Viewer({ title: "Measurement", layers: [this.preview], note: this.previewNote });
    this.previewed = this.previewer.element;
    this.psf = h("select", { onchange: () => this.follow() });
    this.options = new ReconstructionOptions((file, select, accepted) => this.bring(file, select, accepted));
    this.maker = button("Reconstruct", told(() => this.reconstruct()), { class: "primary" });
    this.curve = h("div", { class: "objective", hidden: true });
    this.job = new JobView({ keep: "reconstruct", seen: (job) => this.draw(job) });
    this.cameras = h("select", {});
    this.near = h("input", { type: "text", value: "10cm", spellcheck: false });
    this.far = h("input", { type: "text", value: "100cm", spellcheck: false });
    this.steps = h("input", { type: "number", min: 2, max: 60, value: 7 });
    this.stack = new JobForm("refocus", { without: ["stack", "steps", ...READING], more: { tau: MORE.tau, prior: MORE.prior } });
    this.refocuser = button("Make the focal stack", told(() => this.refocus()));
    this.stackJob = new JobView({ keep: "refocus" });
    this.gallery = new Gallery((result) => this.open(result));
    this.record = new RecordView((record) => this.again(record));
    this.strip = new Strip((path) => this.swept(path), (settings) => this.take(settings));
    this.mode = segments("View", [["picture", "Picture"], ["compare", "Compare"], ["depths", "Depths"], ["results", "Results"]], "picture", (mode) => this.view(mode));
    this.picture = h("div", { class: "stage" }, this.tone.viewer.element, this.video.element, this.spectrum.element, this.strip.element, this.tone.controls, this.record.report, this.record.element);
    this.previewed.hidden = true;
    this.asked = 0;
    /** @type {string | undefined} of the PSF of the picture */
    this.camera = undefined;
    /** @type {import("./record.js").RunRecord | null} of the picture */
    this.about = null;
    fill(place, h("h1", { class: "unseen" }, "Photograph"), h("div", { class: "bench chooser" },
      h("div", { class: "side" },
        group("Raw file and PSF",
          this.choice("Raw file", this.raw), this.choice("PSF", this.psf),
          h("p", { class: "drop pale" }, "Or drop them here: a file called psf is taken as the PSF."), this.previewed),
        group("Reconstruction", this.options.quality.element, h("div", { class: "row" }, this.maker), this.job.element, this.curve,
          ...this.options.elements)),
      h("div", { class: "stage" }, this.mode.element, this.picture, this.compare.element, this.depths.element, this.gallery.element),
      h("div", { class: "side" },
        group("Refocus", option("refocus", "psfs", this.cameras), h("div", { class: "row" },
          h("div", { class: "grow" }, field("Nearest", this.near)), h("div", { class: "grow" }, field("Farthest", this.far)),
          h("div", { class: "narrow" }, option("refocus", "steps", this.steps))), ...this.stack.elements, h("div", { class: "row" }, this.refocuser), this.stackJob.element))));
    this.dropHere();
    told(async () => this.finish(await this.job.again()))();
    told(async () => this.focused(await this.stackJob.again(), false))();
  }

  enter() {
    told(() => this.list())();
  }

  /** @param {string} key @param {boolean} [control] @param {boolean} [shift] */
  key(key, control, shift) {
    if (control && key.toLowerCase() === "z" && !this.picture.hidden) return this.tone.step(shift ? 1 : -1);
    return false;
  }

  async list() {
    const [files, darks, psfFiles, weights, several, single, cameras] = await Promise.all([
      filesBy(raw), filesBy(raw, ["calibration", "shots", "uploads"]), filesBy(psfFile, ["uploads"]), filesBy(weightsFile, ["uploads"]), fieldPsfChoices(), psfChoices(), calibratedCameras()]);
    const psfs = [...several, ...single];
    offerFiles(this.raw, files, "Choose a raw file");
    this.options.offer({ darks, weights });
    offerFiles(this.psf, psfFiles, psfs.length || psfFiles.length ? "Choose a PSF" : "None yet: calibrate, or bring a file", psfs);
    setOptions(this.cameras, cameras.length ? cameras : [{ value: "", label: "None yet: calibrate one" }]);
    const newest = files.find(({ place }) => place.endsWith("/shots"))?.files.find((each) => each.kind === "raw");
    if (!this.raw.value && newest) {
      this.raw.value = newest.path;
      told(() => this.look())();
    }
    const likely = psfs.find(({ value }) => value === live.state?.psf_path) ?? psfs[0];
    if (!this.psf.value && likely) this.psf.value = likely.value;
  }

  /** The PSF that most likely belongs to the raw file: the one its record names, or a file beside it that is called so. */
  async likelyPsf() {
    const path = this.raw.value;
    const values = [...this.psf.options].map(({ value, label }) => ({ value, label }));
    return await psfOf(path, values) ?? values.find(({ value, label }) =>
      value !== path && folderOf(value) === folderOf(path) && NAMED_PSF.test(label));
  }

  /** A file to choose, or to bring. @param {string} label @param {HTMLSelectElement} select */
  choice(label, select) {
    return h("div", { class: "row low" }, h("div", { class: "grow" }, field(label, select)),
      filePicker("Bring…", told(([file]) => this.bring(file, select)), { "aria-label": `${label} of yours` }));
  }

  /** Store a file of the visitor's and choose it. @param {File} file @param {HTMLSelectElement} select @param {string} [accepted] what may be chosen there */
  async bring(file, select, accepted = "camera raw, .png, .tif, .npy or another of docs/formats.md") {
    this.previewed.hidden = false;
    this.previewNote.textContent = `Storing ${file.name}…`;
    try {
      const path = await upload(file);
      await this.list();
      const before = select.value;
      select.value = path;
      if (!select.value) {
        select.value = before;
        throw new Error(`${file.name} cannot be used here: bring ${accepted}.`);
      }
    } finally {
      this.previewNote.textContent = "";
    }
    if (select === this.raw) await this.look();
  }

  dropHere() {
    const files = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files");
    this.place.addEventListener("dragover", (event) => { if (files(event)) { event.preventDefault(); this.place.classList.add("dropping"); } });
    this.place.addEventListener("dragleave", () => this.place.classList.remove("dropping"));
    this.place.addEventListener("drop", told(async (event) => {
      this.place.classList.remove("dropping");
      const dropped = [...(event.dataTransfer?.files ?? [])];
      if (dropped.length === 0) return;
      event.preventDefault();
      // The raw file comes last: its preview stays.
      for (const file of dropped.filter(({ name }) => NAMED_PSF.test(name))) await this.bring(file, this.psf);
      for (const file of dropped.filter(({ name }) => !NAMED_PSF.test(name))) await this.bring(file, this.raw);
    }));
  }

  /** Show what the chosen file holds. */
  async look() {
    const asked = ++this.asked;
    const path = this.raw.value;
    this.preview.hidden = true;
    this.previewed.hidden = !path;
    this.previewNote.textContent = path ? "Looking at it…" : "";
    if (!path) return;
    try {
      const [{ summary, outputs }, known] = await Promise.all([run("preview", { path }), this.likelyPsf()]);
      if (asked !== this.asked) return;
      if (known) this.psf.value = known.value;
      this.follow();
      const values = new LazyValues(() => PixelValues.of(path), () => this.previewer.again());
      this.preview.src = fileUrl(outputs?.[0] ?? "");
      this.previewer.renew("Measurement", values);
      this.preview.hidden = false;
      const clipped = typeof summary.clipped_fraction === "number" ? `, ${percent(summary.clipped_fraction)} clipped` : "";
      this.previewNote.textContent = `${summary.columns} × ${summary.rows} pixels${clipped}`;
    } catch (error) {
      if (asked === this.asked) this.previewNote.textContent = "";
      throw error;
    }
  }

  /** Refocus with the camera of the PSF that is chosen. */
  follow() {
    const folder = folderOf(this.psf.value);
    if ([...this.cameras.options].some(({ value }) => value === folder)) this.cameras.value = folder;
  }

  async reconstruct() {
    if (!this.raw.value) throw new Error("No raw file is chosen: choose one, or save one on the Viewfinder (key s).");
    if (!this.psf.value) throw new Error("No PSF is chosen: calibrate the camera (key 3), or bring a PSF file.");
    this.maker.disabled = true;
    this.curve.hidden = this.options.quality.value() === "draft"; // It has no iterations.
    fill(this.curve, noCurve());
    this.tone.age();
    if (!this.video.element.hidden) this.video.viewer.age();
    try {
      this.finish(await this.job.run("reconstruct", {
        measurement: this.raw.value, psf: this.psf.value, ...this.options.all(this.psf.value, [...this.cameras.options].map(({ value }) => value)),
      }));
    } finally {
      this.maker.disabled = false;
    }
  }

  /** The objective by iteration. @param {Job} job */
  draw(job) {
    const history = (job.history ?? []).filter(({ objective }) => objective > 0);
    if (history.length < 2) return;
    this.curve.hidden = false;
    fill(this.curve, curve({ x: history.map(({ iteration }) => iteration), y: history.map(({ objective }) => objective),
      log: true, xLabel: "iteration", yLabel: "objective", title: "Objective by iteration" }));
  }

  /** @param {Job | null} job */
  finish(job) {
    const files = filesOf(job?.outputs ?? []);
    if (!job || !files) return;
    const { measurement, psf } = job.options ?? {};
    told(() => this.present(files, psf))();
    told(() => this.compare.refresh(files.picture, measurement))();
  }

  /**
   * Show a result with its values and its record.
   *
   * @param {import("./gallery.js").Files} files
   * @param {string} [psf] that it was reconstructed with
   * @param {boolean} [open] the record too
   */
  async present({ all, picture, linear, video, cube, stack, record }, psf, open) {
    this.view("picture");
    this.camera = (await calibratedCameras()).find(({ value }) => value === folderOf(psf ?? ""))?.value;
    const values = cube ? new LazyValues(() => PixelValues.of(cube), () => this.tone.viewer.again()) : this.valuesOf(linear ?? picture);
    this.about = record ? await recordOf(record) : null;
    if (video) this.video.open(video, this.about ? mainFigures(this.about) : "", fileLinks(all));
    this.play(Boolean(video));
    // Before the picture: who sees it and turns to its depths must not find the stack of the run before.
    if (stack) await this.depths.open(all);
    await this.tone.open(picture, fileLinks(all), values);
    this.spectrum.open(cube ? values : null);
    await this.record.show(record ?? null, open);
    this.strip.renew(this.about?.result.sweep ?? [], folderOf(picture), picture);
  }

  /** Show the video in place of its sheet, or the sheet. @param {boolean} on */
  play(on) {
    if (!on) this.video.video.pause();
    this.video.element.hidden = !on;
    this.tone.viewer.element.hidden = this.tone.controls.hidden = on;
  }

  /** @param {string} path of the file that has them */
  valuesOf(path) {
    return new LazyValues(() => PixelValues.of(path, this.camera), () => this.tone.viewer.again());
  }

  /** Show a picture of a sweep. @param {string} picture */
  async swept(picture) {
    const linear = picture.replace(/\.png$/, ".tif");
    await this.tone.open(picture, fileLinks([picture, linear]), this.valuesOf(linear));
  }

  /** Take the setting of a picture of a sweep, beside those that all of them had. @param {Record<string, any>} settings */
  async take(settings) {
    if (!this.about) return;
    const { sweep, ...all } = settingsOf(this.about);
    this.options.use({ ...all, ...settings });
  }

  /** A result of the gallery. @param {import("./gallery.js").Result} result */
  async open({ files }) {
    const about = files.record ? await recordOf(files.record) : null;
    await this.present(files, about?.inputs?.psf?.path, true);
    await this.compare.refresh(files.picture, about?.inputs?.measurement?.path);
  }

  /** Take files and settings of an earlier result. @param {import("./record.js").RunRecord} record */
  async again(record) {
    const { inputs } = record;
    await this.list();
    for (const [select, role] of /** @type {[HTMLSelectElement, string][]} */ ([[this.raw, "measurement"], [this.psf, "psf"]])) {
      const { path } = inputs[role];
      select.value = path;
      // Depths and bands take all PSFs of a folder, of which one is chosen here.
      if (!select.value) select.value = [...select.options].find(({ value }) => role === "psf" && folderOf(value) === folderOf(path))?.value ?? "";
      if (!select.value) throw new Error(`${baseName(path)} is in no folder of this studio any more: bring it, or start the studio with its folder.`);
    }
    this.options.use(settingsOf(record));
    const psf = this.psf.value;
    await this.look();
    this.psf.value = psf;
  }

  async refocus() {
    if (!this.raw.value) throw new Error("No raw file is chosen: choose one, or save one on the Viewfinder (key s).");
    if (!this.cameras.value) throw new Error("There is no calibrated camera yet: calibrate one (key 3).");
    this.refocuser.disabled = true;
    this.depths.age();
    try {
      this.focused(await this.stackJob.run("refocus", {
        measurement: this.raw.value, psfs: this.cameras.value, ...this.options.reading(), ...this.stack.values(),
        stack: `${this.near.value.trim()},${this.far.value.trim()}`, steps: Number(this.steps.value),
      }), true);
    } finally {
      this.refocuser.disabled = false;
    }
  }

  /** @param {Job | null} job @param {boolean} shown */
  focused(job, shown) {
    if (!job) return;
    told(() => this.depths.open(job.outputs ?? []))();
    if (shown) this.view("depths");
  }

  /** @param {"picture" | "compare" | "depths" | "results"} mode */
  view(mode) {
    this.mode.set(mode);
    this.picture.hidden = mode !== "picture";
    this.compare.element.hidden = mode !== "compare";
    this.depths.element.hidden = mode !== "depths";
    this.gallery.element.hidden = mode !== "results";
    if (mode === "compare") told(() => this.compare.refresh())();
    if (mode === "results") told(() => this.gallery.refresh())();
  }
}

/** @param {HTMLElement} place */
export const photographPanel = (place) => new Photograph(place);
