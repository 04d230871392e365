/* Shared code of the page's scripts: data, DOM elements with text only, number formats, rotations. */
"use strict";
const errors = [];
window.addEventListener("error", (event) => {
  errors.push(String(event.message));
  document.documentElement.dataset.errors = errors.join(" | ");
});

const data = JSON.parse(document.getElementById("data").textContent);
const SVG = "http://www.w3.org/2000/svg";

/* An element with attributes and children; strings become text, never markup. */
function el(name, attributes = {}, ...children) {
  return furnish(document.createElement(name), attributes, children);
}
function svg(name, attributes = {}, ...children) {
  return furnish(document.createElementNS(SVG, name), attributes, children);
}
function furnish(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "style") for (const [name, text] of Object.entries(value)) node.style.setProperty(name, text);
    else node.setAttribute(key, value === true ? "" : String(value));
  }
  node.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}
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

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const minus = (text) => text.replace("-", "\u2212");
const degrees = (value, digits = 2) => (isNumber(value) ? minus((Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits)) + "°" : "–");
const signed = (value, digits = 3) => (isNumber(value) ? (value < 0 ? "\u2212" : "+") + Math.abs(value).toFixed(digits) + "°" : "–");
/* Values below 1 are never rounded to 100 %. */
function percent(fraction, digits = 1) {
  if (!isNumber(fraction)) return "–";
  let shown = digits;
  while (fraction < 1 && Number((100 * fraction).toFixed(shown)) >= 100 && shown < 9) shown += 1;
  return `${(100 * fraction).toFixed(shown)} %`;
}
function seconds(value) {
  if (!isNumber(value)) return "–";
  if (value < 100) return `${value.toFixed(1)} s`;
  const whole = Math.round(value), hours = Math.floor(whole / 3600), rest = whole % 3600;
  const clock = `${Math.floor(rest / 60)}:${String(rest % 60).padStart(2, "0")}`;
  return hours ? `${hours}:${clock.padStart(5, "0")} h` : `${clock} min`;
}
const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const WORDS = {
  pointing: "pointing outside τ", no_samples: "gap in the attitude stream", not_settled: "did not settle", stale: "reports too old", trigger: "camera refused", late_exposure: "exposed late",
  evidence: "no proof of the photo", gimbal: "gimbal refused", crash: "computer stopped", other: "other",
};
const words = (code) => WORDS[code] || code.replaceAll("_", " ");

/* --- geometry: camera frame x boresight, y right, z down; world x yaw 0, y 90° clockwise, z down */
const RAD = Math.PI / 180;
function matrix([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
const turned = (m, [x, y, z]) => m.map((row) => row[0] * x + row[1] * y + row[2] * z);
function direction(elevation, azimuth) {
  const c = Math.cos(elevation * RAD);
  return [c * Math.cos(azimuth * RAD), c * Math.sin(azimuth * RAD), -Math.sin(elevation * RAD)];
}
const elevationOf = (d) => Math.atan2(-d[2], Math.hypot(d[0], d[1])) / RAD;
const azimuthOf = (d) => Math.atan2(d[1], d[0]) / RAD;
const wrap = (angle) => ((angle + 180) % 360 + 360) % 360 - 180;

/* --- the shots, with data for drawing */
const shots = data.shots.map((shot) => {
  const taken = shot.attempts.find((attempt) => attempt.n === shot.accepted) || null;
  const m = matrix((taken && taken.q) || shot.q);
  const { half_width: w, half_height: h } = data.camera;
  const corners = [[-w, -h], [w, -h], [w, h], [-w, h]];
  const outline = [];
  const STEPS = 12;
  corners.forEach(([y0, z0], i) => {
    const [y1, z1] = corners[(i + 1) % 4];
    for (let k = 0; k < STEPS; k += 1) {
      const y = y0 + ((y1 - y0) * k) / STEPS, z = z0 + ((z1 - z0) * k) / STEPS, n = Math.hypot(1, y, z);
      outline.push(turned(m, [1 / n, y / n, z / n]));
    }
  });
  outline.push(outline[0]);
  const boresight = m.map((row) => row[0]);
  const again = taken && shot.attempts.some((attempt) => attempt.n < taken.n && attempt.verdict !== "interrupted");
  const kind = taken ? (shot.bridge ? "bridge" : shot.patch ? "patch" : again ? "retaken" : "first") : "missing";
  return { ...shot, taken, m, outline, boresight, kind };
});
const byIndex = new Map(shots.map((shot) => [shot.i, shot]));
/* Position of a direction in a footprint: 0 at its border, 1 at its centre, negative outside. */
function depth(shot, d) {
  const m = shot.m, { half_width: w, half_height: h } = data.camera;
  const x = m[0][0] * d[0] + m[1][0] * d[1] + m[2][0] * d[2];
  if (x <= 0) return -1;
  const y = m[0][1] * d[0] + m[1][1] * d[1] + m[2][1] * d[2], z = m[0][2] * d[0] + m[1][2] * d[1] + m[2][2] * d[2];
  return 1 - Math.max(Math.abs(y / x) / w, Math.abs(z / x) / h);
}
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
/* Draws now and after each change of width or colour scheme. */
function responsive(node, draw) {
  let width = 0;
  const again = () => { if (node.clientWidth && node.clientWidth !== width) { width = node.clientWidth; draw(width); } };
  new ResizeObserver(again).observe(node);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw(width || node.clientWidth));
  again();
}
