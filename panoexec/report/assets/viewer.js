/* The panorama viewer, with a hot spot for each photo that opens the original next to this page. */
"use strict";
/* More hot spots than this make a browser slow; the sphere map links to every photo. */
const MAX_SPOTS = 800;

function panoramaImage() {
  const block = document.getElementById("panorama-jpeg");
  return block ? `data:image/jpeg;base64,${block.textContent}` : null;
}
function hasWebgl() {
  try {
    const sheet = document.createElement("canvas");
    return Boolean(sheet.getContext("webgl") || sheet.getContext("experimental-webgl"));
  } catch { return false; }
}
function showPanorama(source) {
  const stitched = data.panorama.kind === "stitched", holder = el("div", { id: "viewer" });
  const linked = shots.filter((shot) => shot.taken && shot.photo && shot.photo.href);
  const lead = (stitched
    ? "Stitched from the photos."
    : "A quick look: the photos projected by their measured attitudes, not stitched (see panoexec stitch).")
    + (linked.length > MAX_SPOTS ? " Drag to look around; the sphere map below links to each photo." : " Drag to look around; click a spot to open its photo.");
  const section = card("panorama", stitched ? "Panorama" : "Panorama (quick look)", lead, holder);
  const flat = () => {
    section.classList.add("viewer-off");
    holder.replaceChildren(el("img", { src: source, alt: "The panorama in equirectangular projection" }));
  };
  if (!hasWebgl() || !window.pannellum) { flat(); return; }
  const first = shots.find((shot) => shot.taken), [low, high] = data.band.elevation;
  const spots = (linked.length > MAX_SPOTS ? [] : linked).map((shot) => ({
    pitch: elevationOf(shot.boresight),
    yaw: azimuthOf(shot.boresight),
    text: `shot ${shot.i}: ${shot.photo.name}`,
    URL: shot.photo.href,
    cssClass: "pnlm-shot",
    attributes: { target: "_blank", rel: "noopener", "data-shot": String(shot.i) },
  }));
  try {
    const viewer = window.pannellum.viewer(holder, {
      type: "equirectangular", panorama: source, autoLoad: true, escapeHTML: true, showFullscreenCtrl: true, mouseZoom: "fullscreenonly",
      yaw: first ? azimuthOf(first.boresight) : 0, pitch: Math.max(low + 25, Math.min(high - 15, -12)), hfov: 95, minHfov: 20,
      compass: true, northOffset: data.mission.reference.yaw_north_deg || 0, backgroundColor: [0.12, 0.13, 0.15], hotSpots: spots,
    });
    viewer.on("load", () => { document.documentElement.dataset.viewer = "loaded"; });
    viewer.on("error", flat);
  } catch { flat(); }
}
