/* The page of a tour: map of the stations, list of stops, and a viewer that hops from panorama to panorama. */
"use strict";
const tourData = JSON.parse(document.getElementById("data").textContent);
const stops = tourData.stops;
const MAP_HEIGHT = 380, MARGIN = 46;
const FINE = new Set(["complete"]), BROKEN = new Set(["aborted", "failed"]);
const kindOf = (stop) => (FINE.has(stop.outcome) ? "good" : BROKEN.has(stop.outcome) ? "bad" : "warn");
const wrap = (angle) => ((angle % 360) + 540) % 360 - 180;
let viewer = null, shown = null;

const titleOf = (stop) => `${stop.number}${stop.name ? ` · ${stop.name}` : ""} (waypoint ${stop.waypoint})`;
const distance = (a, b) => Math.hypot(b.at[0] - a.at[0], b.at[1] - a.at[1]);
/* From north, clockwise. */
const bearing = (a, b) => Math.atan2(b.at[1] - a.at[1], b.at[0] - a.at[0]) * 180 / Math.PI;

function hops(stop) {
  return stops.filter((other) => other.panorama && other !== stop && distance(stop, other) > 0.5).map((other) => ({
    type: "scene", sceneId: String(other.number), pitch: -3, yaw: wrap(bearing(stop, other) - stop.north),
    text: `${titleOf(other)}, ${distance(stop, other).toFixed(0)} m`, cssClass: "pnlm-shot", attributes: { "data-stop": String(other.number) },
  }));
}
function pictureOf(stop) {
  return `data:image/jpeg;base64,${document.getElementById(`panorama-${stop.number}`).textContent}`;
}
function hasWebgl() {
  try {
    const sheet = document.createElement("canvas");
    return Boolean(sheet.getContext("webgl") || sheet.getContext("experimental-webgl"));
  } catch { return false; }
}
function mark(number) {
  shown = number;
  document.documentElement.dataset.stop = String(number);
  for (const node of document.querySelectorAll("[data-number]")) node.classList.toggle("chosen", node.dataset.number === String(number));
}
function show(stop) {
  if (!stop.panorama) return;
  if (viewer) viewer.loadScene(String(stop.number));
  else document.getElementById("viewer").replaceChildren(el("img", { src: pictureOf(stop), alt: titleOf(stop) }));
  mark(stop.number);
}
function panoramas() {
  const seen = stops.filter((stop) => stop.panorama), section = document.getElementById("panorama");
  if (!seen.length) return;
  const holder = el("div", { id: "viewer" });
  section.hidden = false;
  section.append(el("h2", {}, "Panoramas"), el("p", { class: "lead" }, "Drag to look around; click a spot to hop to the panorama that was taken there."), holder);
  if (!hasWebgl() || !window.pannellum) {
    section.classList.add("viewer-off");
    show(seen[0]);
    return;
  }
  const scenes = {};
  for (const stop of seen) {
    scenes[String(stop.number)] = {
      type: "equirectangular", panorama: pictureOf(stop), northOffset: stop.north, hotSpots: hops(stop), title: titleOf(stop), pitch: -12,
    };
  }
  viewer = window.pannellum.viewer(holder, {
    escapeHTML: true, /* it is looked for here only */
    default: { firstScene: String(seen[0].number), autoLoad: true, compass: true, hfov: 95, minHfov: 20, sceneFadeDuration: 400, mouseZoom: "fullscreenonly", backgroundColor: [0.12, 0.13, 0.15] },
    scenes,
  });
  viewer.on("scenechange", (id) => mark(Number(id)));
  viewer.on("load", () => { document.documentElement.dataset.viewer = "loaded"; });
  mark(seen[0].number);
}
function drawMap(node, width) {
  const norths = stops.map((stop) => stop.at[0]), easts = stops.map((stop) => stop.at[1]);
  const low = [Math.min(...norths), Math.min(...easts)], high = [Math.max(...norths), Math.max(...easts)];
  const scale = Math.min((width - 2 * MARGIN) / Math.max(high[1] - low[1], 10), (MAP_HEIGHT - 2 * MARGIN) / Math.max(high[0] - low[0], 10));
  const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const x = (stop) => width / 2 + (stop.at[1] - middle[1]) * scale, y = (stop) => MAP_HEIGHT / 2 - (stop.at[0] - middle[0]) * scale;
  const bar = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((metres) => metres * scale >= 60) || 10000;
  const spots = stops.map((stop) => {
    const spot = svg("g", { class: "stop", "data-number": stop.number, tabindex: stop.panorama ? 0 : null, role: stop.panorama ? "button" : null, "aria-label": titleOf(stop),
      onclick: () => show(stop), onkeydown: (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); show(stop); } } },
      svg("circle", { cx: x(stop), cy: y(stop), r: 15, fill: colour(kindOf(stop)), "fill-opacity": stop.panorama ? 1 : 0.45 }),
      svg("text", { x: x(stop), y: y(stop) + 5, "text-anchor": "middle", style: { fill: colour("card") }, "font-weight": 650, "font-size": 14 }, String(stop.number)),
      svg("title", {}, `${titleOf(stop)}: ${stop.outcome}`));
    return spot;
  });
  node.replaceChildren(svg("svg", { width, height: MAP_HEIGHT, viewBox: `0 0 ${width} ${MAP_HEIGHT}`, role: "group", "aria-label": "Map of the stations" },
    svg("polyline", { points: stops.map((stop) => `${x(stop).toFixed(1)},${y(stop).toFixed(1)}`).join(" "), fill: "none", stroke: colour("muted"), "stroke-width": 1.5, "stroke-dasharray": "5 4" }),
    spots,
    svg("path", { d: `M${width - 24} 44 l0 -26 m-5 8 l5 -8 l5 8`, fill: "none", stroke: colour("muted"), "stroke-width": 1.6 }),
    svg("text", { x: width - 24, y: 58, "text-anchor": "middle", fill: colour("muted"), "font-size": 12 }, "N"),
    svg("path", { d: `M16 ${MAP_HEIGHT - 14} h${bar * scale}`, stroke: colour("muted"), "stroke-width": 2 }),
    svg("text", { x: 16, y: MAP_HEIGHT - 20, fill: colour("muted"), "font-size": 12 }, bar >= 1000 ? `${bar / 1000} km` : `${bar} m`)));
  if (shown !== null) mark(shown);
}
function list() {
  const rows = stops.map((stop) => el("tr", { "data-number": stop.number },
    el("td", {}, String(stop.number)), el("td", {}, String(stop.waypoint)),
    el("td", {}, stop.report ? el("a", { href: stop.report }, stop.name || stop.preset) : stop.name || stop.preset),
    el("td", {}, el("span", { class: `pill ${kindOf(stop)}` }, stop.outcome)),
    el("td", {}, stop.shots ? `${stop.shots[0]}/${stop.shots[1]}` : "–"),
    el("td", {}, stop.certified === null ? "–" : stop.certified ? "yes" : "no"),
    el("td", {}, [stop.reason, stop.why].filter(Boolean).join("; ")),
    el("td", {}, when(stop.arrived))));
  document.getElementById("stops").append(el("h2", {}, "Stops"), el("table", {},
    el("thead", {}, el("tr", {}, ["stop", "waypoint", "panorama", "outcome", "shots", "certified", "reason", "arrived"].map((text) => el("th", {}, text)))),
    el("tbody", {}, rows)));
}
function tourPage() {
  const done = stops.filter((stop) => FINE.has(stop.outcome)).length;
  document.getElementById("head").append(el("h1", {}, `Tour ${tourData.tour.id.replace("tour-", "")}`),
    el("span", { class: `pill ${done === stops.length && done ? "good" : "warn"}` }, `${done} of ${plural(stops.length, "stop")} complete`),
    el("p", {}, `${tourData.tour.vehicle}, ${plural(tourData.tour.waypoints.length, "station")} in its mission${tourData.tour.ended ? "" : ", under way"}`));
  const holder = el("div", {});
  document.getElementById("map").append(el("h2", {}, "Map"), holder);
  panoramas();
  if (stops.length) responsive(holder, (width) => drawMap(holder, width));
  else holder.append(el("p", { class: "lead" }, "No station was reached."));
  list();
  const missed = tourData.tour.waypoints.filter((number) => !stops.some((stop) => stop.waypoint === number));
  if (missed.length) document.getElementById("stops").append(el("p", { class: "lead" }, `No stop at waypoints ${missed.join(", ")}.`));
  document.getElementById("foot").textContent = `Written by panoexec ${tourData.made.version}, ${when(tourData.made.time.replace("+00:00", "Z"))}. Panorama viewer: Pannellum (MIT licence).`;
  document.documentElement.dataset.ready = "yes";
}
tourPage();
