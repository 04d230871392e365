/* Shared code of the page's scripts, which follow those of panoexec/pages: data, shots, the selected one. */
"use strict";
const errors = [];
window.addEventListener("error", (event) => {
  errors.push(String(event.message));
  document.documentElement.dataset.errors = errors.join(" | ");
});

const data = JSON.parse(document.getElementById("data").textContent);
function card(id, title, lead, ...children) {
  const node = document.getElementById(id);
  node.hidden = false;
  node.replaceChildren();
  return furnish(node, {}, [el("h2", {}, title), lead ? el("p", { class: "lead" }, lead) : null, children]);
}
function facts(rows) {
  const shown = rows.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return el("table", {}, el("tbody", {}, shown.map(([name, value]) => el("tr", {}, el("th", {}, name), el("td", {}, value)))));
}

const WORDS = {
  pointing: "pointing outside τ", no_samples: "gap in the attitude stream", not_settled: "did not settle", stale: "reports too old", trigger: "camera refused", late_exposure: "exposed late",
  evidence: "no proof of the photo", parallax: "drifted too far", gimbal: "gimbal refused", crash: "computer stopped", other: "other",
};
const words = (code) => WORDS[code] || code.replaceAll("_", " ");

/* --- the shots, with data for drawing */
const shots = data.shots.map((shot) => {
  const taken = shot.attempts.find((attempt) => attempt.n === shot.accepted) || null;
  const m = matrix((taken && taken.q) || shot.q);
  const outline = outlineOf(m, data.camera.half_width, data.camera.half_height);
  const boresight = boresightOf(m);
  const again = taken && shot.attempts.some((attempt) => attempt.n < taken.n && attempt.verdict !== "interrupted");
  const kind = taken ? (shot.bridge ? "bridge" : shot.patch ? "patch" : again ? "retaken" : "first") : "missing";
  return { ...shot, taken, m, outline, boresight, kind };
});
const byIndex = new Map(shots.map((shot) => [shot.i, shot]));
const depth = (shot, d) => depthIn(shot.m, data.camera.half_width, data.camera.half_height, d);
const attempts = shots
  .flatMap((shot) => shot.attempts.map((attempt) => ({ ...attempt, shot })))
  .sort((a, b) => (a.times ? a.times.start : Infinity) - (b.times ? b.times.start : Infinity) || a.shot.i - b.shot.i || a.n - b.n);

/* --- the selected shot (one at a time) and its listeners */
const chosen = { shot: null, pinned: false, listeners: [] };
function choose(shot, { pin = false, show = false } = {}) {
  if (chosen.pinned && !pin) return;
  chosen.pinned = pin && shot !== null;
  if (shot === chosen.shot && !show) return;
  chosen.shot = shot;
  for (const listener of chosen.listeners) listener(shot, show);
}

const tip = document.getElementById("tip");
function showTip(event, text) {
  tip.textContent = text;
  tip.hidden = false;
  const box = tip.getBoundingClientRect(), gap = 14;
  const x = Math.min(event.clientX + gap, window.innerWidth - box.width - 6);
  const y = event.clientY + gap + box.height > window.innerHeight ? event.clientY - gap - box.height : event.clientY + gap;
  tip.style.left = `${Math.max(6, x)}px`;
  tip.style.top = `${Math.max(6, y)}px`;
}
const hideTip = () => { tip.hidden = true; };
