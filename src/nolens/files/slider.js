const part = (name) => document.getElementById(name);
const picture = part("picture"), slider = part("depth"), shown = part("shown");
const mark = part("mark"), play = part("play"), all = part("all");
let timer = null;

function show(number) {
  slider.value = number;
  picture.src = stack.pages[number];
  picture.alt = "The scene, sharp at " + stack.depths[number];
  shown.textContent = stack.depths[number];
  slider.setAttribute("aria-valuetext", stack.depths[number]);
  all.setAttribute("aria-pressed", "false");
}

function showAll() {
  picture.src = stack.everywhere;
  picture.alt = "The scene, sharp everywhere";
  shown.textContent = "everywhere";
  mark.hidden = true;
  all.setAttribute("aria-pressed", "true");
}

function stop() {
  clearInterval(timer);
  timer = null;
  play.setAttribute("aria-pressed", "false");
}

slider.addEventListener("input", () => { stop(); mark.hidden = true; show(Number(slider.value)); });
all.addEventListener("click", () => { stop(); showAll(); });
play.addEventListener("click", () => {
  if (timer !== null) { stop(); return; }
  play.setAttribute("aria-pressed", "true");
  mark.hidden = true;
  let step = 1;
  timer = setInterval(() => {
    const last = stack.pages.length - 1, now = Number(slider.value);
    if (now + step > last || now + step < 0) { step = -step; }
    show(Math.min(last, Math.max(0, now + step)));
  }, 350);
});
picture.addEventListener("click", (event) => {
  stop();
  const box = picture.getBoundingClientRect(), grid = stack.best_page;
  const across = (event.clientX - box.left) / box.width;
  const down = (event.clientY - box.top) / box.height;
  const place = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));
  show(grid[place(down, grid.length)][place(across, grid[0].length)]);
  mark.style.left = 100 * across + "%";
  mark.style.top = 100 * down + "%";
  mark.hidden = false;
});
showAll();
