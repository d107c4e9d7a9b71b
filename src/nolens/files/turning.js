const volume = document.getElementById("volume");
const planes = [...volume.querySelectorAll(".plane")];
const most = 0.25;
let side = 0, up = 0, from = null;

function turn(right, down) {
  side = Math.min(most, Math.max(-most, right));
  up = Math.min(most, Math.max(-most, down));
  for (const plane of planes) {
    const near = 0.5 - Number(plane.dataset.place);
    plane.style.transform = `translate(${100 * near * side}%, ${100 * near * up}%)`;
  }
}

volume.addEventListener("pointerdown", (event) => {
  from = [event.clientX, event.clientY, side, up];
  volume.setPointerCapture(event.pointerId);
});
volume.addEventListener("pointermove", (event) => {
  if (from === null) { return; }
  const box = volume.getBoundingClientRect();
  turn(from[2] + (event.clientX - from[0]) / box.width, from[3] + (event.clientY - from[1]) / box.height);
});
volume.addEventListener("pointerup", () => { from = null; });
volume.addEventListener("dblclick", () => { turn(0, 0); });
volume.addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const step = steps[event.key];
  if (!step) { return; }
  event.preventDefault();
  turn(side + 0.02 * step[0], up + 0.02 * step[1]);
});
turn(0, 0);
