// How far a batch is: its manifest, asked for every two seconds.

const EVERY_MS = 2000;
const element = (id) => document.getElementById(id);
const folder = new URLSearchParams(location.search).get("folder");
let begun = null;

function paceText(done, left) {
  const now = performance.now() / 1000;
  if (begun === null || done < begun.done) begun = { done, now };
  const rate = (done - begun.done) / (now - begun.now);
  if (left === 0 || !(rate > 0)) return "";
  const each = rate >= 1 ? `${rate.toPrecision(3)} a second` : `${(1 / rate).toPrecision(3)} s each`;
  return `${each}, about ${Math.ceil(left / rate / 60)} min to go`;
}

function show({ counts, failed }) {
  const all = counts.waiting + counts.writing + counts.done + counts.failed;
  element("bar").max = all;
  element("bar").value = counts.done + counts.failed;
  element("done").textContent = `${counts.done} of ${all} done`;
  element("pace").textContent = paceText(counts.done, all - counts.done - counts.failed);
  element("failures").hidden = counts.failed === 0;
  element("failures").textContent = `${counts.failed} failed`;
  const lines = Object.entries(failed).map(([name, reason]) => {
    const line = document.createElement("li");
    line.textContent = `${name}: ${reason}`;
    return line;
  });
  element("failed").replaceChildren(...lines);
}

async function ask() {
  try {
    const answer = await fetch(`api/batch?path=${encodeURIComponent(folder)}`);
    const found = await answer.json();
    element("trouble").hidden = answer.ok;
    element("state").hidden = !answer.ok;
    if (answer.ok) show(found);
    else element("trouble").textContent = found.detail;
  } catch {
    element("trouble").hidden = false;
    element("trouble").textContent = "the studio does not answer";
  }
  setTimeout(ask, EVERY_MS);
}

if (folder) {
  element("folder").value = folder;
  ask();
}
