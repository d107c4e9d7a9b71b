// Shows each picture of `nolens collect` on the whole screen, and says when it is drawn.

const RETRY_MS = 500;
const picture = document.getElementById("picture");
const start = document.getElementById("start");

const post = (path, body) =>
  fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const frame = () => new Promise((done) => requestAnimationFrame(done));

async function showNext(number) {
  const answer = await fetch(`api/screen?after=${number}`);
  const newest = answer.ok ? await answer.json() : null;
  if (!newest) return number;
  picture.src = `api/screen/picture/${newest.number}`;
  await picture.decode();
  picture.hidden = false;
  // What is drawn in this frame is on the screen with the one after the next.
  await frame();
  await frame();
  await post("api/screen/shown", newest);
  return newest.number;
}

start.addEventListener("click", async () => {
  start.hidden = true;
  document.body.classList.add("running");
  await document.documentElement.requestFullscreen?.().catch(() => {});
  await frame();
  const by = window.devicePixelRatio;
  await post("api/screen/size", {
    rows: Math.round(window.innerHeight * by),
    columns: Math.round(window.innerWidth * by),
  });
  for (let number = 0; ; ) {
    try {
      number = await showNext(number);
    } catch {
      await pause(RETRY_MS);
    }
  }
});
