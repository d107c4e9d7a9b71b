// @ts-check
/** What the twin looks at: a built-in picture, a picture or video of the visitor's, or the webcam. */

import { post, showScene, studio } from "./api.js";
import { button, field, filePicker, fill, group, h, setOptions } from "./dom.js";
import { live } from "./live.js";
import { told } from "./notices.js";

const WEBCAM = { width: 320, height: 240 };
const LONG_SIDE = 320;
const BETWEEN_MS = 1000 / 15;
const QUALITY = 0.85;
const READABLE = ["image/jpeg", "image/png"];
const LONGEST = 2048;

export class SceneControls {
  constructor() {
    this.select = h("select", { onchange: told(() => this.choose(this.select.value)) });
    const file = filePicker("A picture or video…", told(([picture]) => this.drop(picture)), { accept: "image/*,video/*", title: "Pictures and videos can be dropped on the page, too." });
    this.webcam = button("Use my webcam", told(async () => (this.stream ? this.stop() : this.watch())), { "aria-pressed": "false" });
    this.said = h("p", { class: "pale", role: "status" });
    this.element = group("Scene", field("Built-in picture", this.select), h("div", { class: "row" }, file, this.webcam), this.said);
    this.element.hidden = true;
    /** @type {MediaStream | null} */
    this.stream = null;
    this.video = h("video", { muted: true, playsInline: true, loop: true });
    this.canvas = h("canvas");
    this.moving = false;
    this.sent_ms = 0;
    this.ready = true;
    this.listed = false;
    this.dropHere();
  }

  /** @param {any} state */
  follow(state) {
    this.element.hidden = !String(state.source ?? "").startsWith("twin");
    if (this.element.hidden) return;
    if (!this.listed) {
      this.listed = true;
      told(() => this.list())();
    }
    if (state.scene && document.activeElement !== this.select) this.select.value = state.scene;
  }

  async list() {
    const { scenes } = await studio();
    setOptions(this.select, [
      ...scenes.map((/** @type {any} */ each) => ({ value: each.id, label: each.label })),
      { value: "picture", label: "A picture of yours", disabled: true },
      { value: "webcam", label: "A webcam or video", disabled: true },
    ]);
    if (live.state?.scene) this.select.value = live.state.scene;
  }

  /** @param {string} builtin */
  async choose(builtin) {
    this.stop();
    await post("api/live/scene", { builtin });
    fill(this.said);
  }

  /** @param {File} picture */
  async drop(picture) {
    this.stop();
    if (picture.type.startsWith("video/")) {
      await this.play(picture);
      return;
    }
    if (!picture.type.startsWith("image/")) throw new Error(`${picture.name} is not a picture or video: give a JPEG, PNG, MP4 or WebM file.`);
    await showScene(await suited(picture));
    this.select.value = "picture";
    this.said.textContent = `The camera looks at ${picture.name}.`;
  }

  /** Show a video over and over. @param {File} video */
  async play(video) {
    this.video.src = URL.createObjectURL(video);
    try {
      await this.video.play();
    } catch {
      this.stop();
      throw new Error(`${video.name} cannot be played by this browser: give an MP4 (H.264) or WebM file.`);
    }
    this.said.textContent = `The camera looks at ${video.name}.`;
    this.begin();
  }

  /** What the video element shows goes to the camera from now on. */
  begin() {
    const { videoWidth, videoHeight } = this.video;
    const fraction = LONG_SIDE / Math.max(videoWidth, videoHeight);
    this.canvas.width = Math.round(videoWidth * fraction);
    this.canvas.height = Math.round(videoHeight * fraction);
    this.select.value = "webcam";
    this.moving = true;
    this.acknowledged();
  }

  /** Pictures that are dropped anywhere on the viewfinder. */
  dropHere() {
    const onto = (/** @type {DragEvent} */ event) => this.element.checkVisibility() && event.dataTransfer?.types.includes("Files");
    document.addEventListener("dragover", (event) => {
      if (!onto(event)) return;
      event.preventDefault();
      this.element.classList.add("dropping");
    });
    document.addEventListener("dragleave", () => this.element.classList.remove("dropping"));
    document.addEventListener("drop", told(async (event) => {
      this.element.classList.remove("dropping");
      const picture = event.dataTransfer?.files[0];
      if (!onto(event) || !picture) return;
      event.preventDefault();
      await this.drop(picture);
    }));
  }

  async watch() {
    if (!navigator.mediaDevices) {
      throw new Error("This browser gives webcams to pages of this machine only: open the studio at http://127.0.0.1.");
    }
    try {
      this.stream = await navigator.mediaDevices.getUserMedia({ video: WEBCAM, audio: false });
    } catch (error) {
      const name = error instanceof DOMException ? error.name : "";
      throw new Error(name === "NotFoundError" ? "No webcam was found: plug one in, or choose a picture."
        : name === "NotAllowedError" ? "The browser does not let this page use the webcam: allow it beside the address."
          : "The webcam cannot be used: another program may have it.");
    }
    this.video.srcObject = this.stream;
    await this.video.play();
    this.webcam.setAttribute("aria-pressed", "true");
    this.webcam.textContent = "Stop the webcam";
    this.said.textContent = "The camera looks at what your webcam sees. Nothing leaves this machine.";
    this.stream.getVideoTracks()[0].addEventListener("ended", () => this.stop());
    this.begin();
  }

  stop() {
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.stream = null;
    this.moving = false;
    this.video.pause();
    this.video.srcObject = null;
    if (this.video.src) URL.revokeObjectURL(this.video.src);
    this.video.removeAttribute("src");
    this.webcam.setAttribute("aria-pressed", "false");
    this.webcam.textContent = "Use my webcam";
    fill(this.said);
  }

  /** A frame came back, so the next picture of the webcam or video may go. */
  acknowledged() {
    const now = performance.now();
    if (!this.moving || !this.ready || now - this.sent_ms < BETWEEN_MS) return;
    this.sent_ms = now;
    this.ready = false;
    this.canvas.getContext("2d")?.drawImage(this.video, 0, 0, this.canvas.width, this.canvas.height);
    this.canvas.toBlob((picture) => {
      this.ready = true;
      if (picture && this.moving) live.send(picture);
    }, "image/jpeg", QUALITY);
  }
}

/** A picture as the studio takes it: JPEG or PNG of a moderate size. @param {File} picture @returns {Promise<Blob>} */
async function suited(picture) {
  let bitmap;
  try {
    bitmap = await createImageBitmap(picture);
  } catch {
    throw new Error(`${picture.name} cannot be read as a picture: give a JPEG or PNG file.`);
  }
  const fraction = Math.min(1, LONGEST / Math.max(bitmap.width, bitmap.height));
  if (fraction === 1 && READABLE.includes(picture.type)) return picture;
  const canvas = h("canvas", { width: Math.round(bitmap.width * fraction), height: Math.round(bitmap.height * fraction) });
  canvas.getContext("2d")?.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  return new Promise((done, failed) => canvas.toBlob(
    (made) => (made ? done(made) : failed(new Error(`${picture.name} is too large to be shown.`))), "image/jpeg", 0.95));
}
