/* The sphere map: footprints, ties and holes on the sphere or the flat map. */
"use strict";
const MAP_WIDTH = 720;

function coverageCounts(width) {
  const height = width / 2, counts = new Uint8Array(width * height);
  const taken = shots.filter((shot) => shot.taken);
  const reach = Math.atan(Math.hypot(data.camera.half_width, data.camera.half_height)) / RAD;
  const levels = taken.map((shot) => elevationOf(shot.boresight));
  for (let row = 0; row < height; row += 1) {
    const elevation = 90 - ((row + 0.5) / height) * 180;
    const near = taken.filter((_, k) => Math.abs(levels[k] - elevation) <= reach);
    for (let column = 0; column < width; column += 1) {
      const d = direction(elevation, ((column + 0.5) / width) * 360 - 180);
      let count = 0;
      for (const shot of near) if (depth(shot, d) >= 0) count += 1;
      counts[row * width + column] = count;
    }
  }
  return counts;
}
function inBand(elevation, azimuth) {
  const { elevation: [low, high], azimuth: [left, right], masks } = data.band;
  if (elevation < low || elevation > high || !inSector(azimuth, left, right)) return false;
  return !masks.some(([a, b, c, d]) => elevation >= a && elevation <= b && inSector(azimuth, c, d));
}
function coverageTexture(counts) {
  const width = MAP_WIDTH, height = width / 2, pixels = new Uint8ClampedArray(4 * width * height);
  const colours = [0, 1, 2, 3, 4].map((k) => rgb(`c${k}`)), outside = rgb("outside");
  for (let row = 0; row < height; row += 1) {
    const elevation = 90 - ((row + 0.5) / height) * 180;
    for (let column = 0; column < width; column += 1) {
      const k = row * width + column, count = Math.min(counts[k], 4);
      const asked = inBand(elevation, ((column + 0.5) / width) * 360 - 180);
      const paint = asked || count ? colours[count] : outside;
      // outside the requested band, covered areas are paler
      for (let c = 0; c < 3; c += 1) pixels[4 * k + c] = asked ? paint[c] : (paint[c] + outside[c]) / 2;
      pixels[4 * k + 3] = 255;
    }
  }
  return { width, height, pixels };
}
function pictureTexture(image) {
  const width = Math.min(2048, image.naturalWidth), height = Math.round(width / 2);
  const sheet = el("canvas", { width, height }), context = sheet.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0, width, height);
  return { width, height, pixels: context.getImageData(0, 0, width, height).data };
}

class SphereMap extends SphereView {
  constructor(canvas) {
    super(canvas, {
      layers: [() => this.drawShots(), () => this.drawTies(), () => this.drawHoles(), () => this.drawChosen(), () => this.note()],
      hovered: (d) => choose(d && this.shotAt(d)),
      picked: (d) => {
        const shot = d && this.shotAt(d);
        choose(shot, { pin: shot !== null && !(chosen.pinned && chosen.shot === shot) });
        if (!shot) { chosen.pinned = false; choose(null); }
      },
    });
    const first = shots.find((shot) => shot.taken);
    this.yaw = first ? azimuthOf(first.boresight) : 0;
    this.north = data.mission.reference.yaw_north_deg || 0;
    chosen.listeners.push((shot, show) => {
      if (shot && show) this.look(shot.boresight);
      this.ask();
    });
  }
  /* The coverage has other colours in the dark. */
  resized() {
    this.counts ??= coverageCounts(MAP_WIDTH);
    this.textures ??= {};
    this.textures.coverage = coverageTexture(this.counts);
    this.paintWith(this.paint || "coverage");
  }
  paintWith(paint) {
    this.paint = paint;
    this.texture = this.textures[paint];
    this.onPhotos = paint === "photos";
    this.ask();
  }
  usePicture(image) {
    this.textures.photos = pictureTexture(image);
    this.paintWith("photos");
  }
  show(view) {
    this.view = view;
    this.canvas.closest(".globe").classList.toggle("flat", view === "map");
    super.show(view);
  }
  shotAt(d) {
    let best = null, deepest = 0;
    for (const shot of shots) {
      const inside = depth(shot, d);
      if (inside > deepest) { deepest = inside; best = shot; }
    }
    return best;
  }
  drawShots() {
    const c = this.context, basis = this.basis();
    const ink = this.onPhotos ? "rgba(255,255,255,.75)" : colour("ink");
    const looks = { first: ink, retaken: colour("warn"), patch: colour("patch"), bridge: colour("accent"), missing: colour("bad") };
    const dense = shots.length > 60;
    for (const shot of shots) {
      c.lineWidth = shot.kind === "first" ? (dense ? 0.8 : 1.1) : 1.9;
      c.globalAlpha = shot.kind === "first" ? 0.8 : 1;
      c.strokeStyle = looks[shot.kind];
      c.setLineDash(shot.kind === "missing" ? [5, 4] : []);
      this.line(shot.outline, basis);
      if (this.paint === "coverage") this.dot(shot.boresight, basis, looks[shot.kind], dense ? 1.6 : 2.4);
    }
  }
  drawChosen() {
    if (!chosen.shot) return;
    const c = this.context, basis = this.basis();
    c.lineWidth = 4.5; c.strokeStyle = "rgba(0,0,0,.45)"; this.line(chosen.shot.outline, basis);
    c.lineWidth = 2.6; c.strokeStyle = "#ffd54a"; this.line(chosen.shot.outline, basis);
    this.dot(chosen.shot.boresight, basis, "#ffd54a", 4.5);
  }
  note() {
    const state = this.canvas.dataset;
    state.paint = this.paint;
    state.shot = chosen.shot ? chosen.shot.i : "";
  }
  /* Which photos their content ties to each other; ties without which a group falls apart are marked. */
  drawTies() {
    const content = data.certificate && data.certificate.content;
    if (!content || !content.checked) return;
    const c = this.context, basis = this.basis(), places = new Map(shots.map((shot) => [shot.i, shot.boresight]));
    const bridges = new Set(content.bridges.map(([a, b]) => `${Math.min(a, b)}-${Math.max(a, b)}`));
    /* a dark edge first: a thin line alone is lost on a photo of the same colour */
    for (const edge of [true, false]) {
      for (const [a, b] of content.ties) {
        const from = places.get(a), to = places.get(b);
        if (!from || !to) continue;
        const bridge = bridges.has(`${Math.min(a, b)}-${Math.max(a, b)}`);
        c.lineWidth = (bridge ? 2.4 : 1.5) + (edge ? 2 : 0);
        c.globalAlpha = edge ? 0.5 : 1;
        c.strokeStyle = edge ? "#000" : bridge ? "#ffb347" : "#5cf2a0";
        this.line(arc(from, to), basis);
      }
    }
    c.globalAlpha = 1;
    for (const i of content.geometry_only) if (places.has(i)) this.dot(places.get(i), basis, colour("warn"), 4);
    this.canvas.dataset.ties = content.ties.length;
  }
  drawHoles() {
    const c = this.context, basis = this.basis();
    for (const hole of (data.certificate && data.certificate.holes) || []) {
      const p = this.place(direction(hole.elevation_deg, hole.azimuth_deg), basis);
      // large holes are visible themselves; a small one gets a mark
      if (!p || hole.size_deg > 12) continue;
      const size = Math.max(7, (hole.size_deg / 2) * RAD * this.radius);
      c.strokeStyle = colour("c0"); c.lineWidth = 2.5;
      c.beginPath(); c.arc(p[0], p[1], size, 0, 2 * Math.PI); c.stroke();
    }
  }
}
