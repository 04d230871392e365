/* The sphere map: footprints on a sphere seen from inside (photos are not mirrored) or on a flat map. */
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
  const between = (from, to) => ((azimuth - from) % 360 + 360) % 360 <= to - from;
  if (elevation < low || elevation > high || !between(left, right)) return false;
  return !masks.some(([a, b, c, d]) => elevation >= a && elevation <= b && between(c, d));
}
function rgb(name) {
  const hex = colour(name).replace("#", "");
  return [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16));
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

class SphereMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.sheet = el("canvas");
    const first = shots.find((shot) => shot.taken);
    this.yaw = first ? azimuthOf(first.boresight) : 0;
    this.pitch = -25;
    this.zoom = 1;
    this.view = "ball";
    this.paint = "coverage";
    this.counts = coverageCounts(MAP_WIDTH);
    this.textures = { coverage: coverageTexture(this.counts) };
    this.drag = null;
    this.pointers = new Set();
    this.listen();
    responsive(canvas.parentElement, (width) => {
      this.textures.coverage = coverageTexture(this.counts);
      this.resize(width);
    });
    chosen.listeners.push((shot, show) => {
      if (shot && show) { this.yaw = azimuthOf(shot.boresight); this.pitch = Math.max(-80, Math.min(80, elevationOf(shot.boresight))); }
      this.ask();
    });
  }
  usePicture(image) {
    this.textures.photos = pictureTexture(image);
    this.paint = "photos";
    this.ask();
  }
  resize(width) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.width = width;
    this.height = this.view === "ball" ? Math.min(width, 560) : width / 2;
    this.canvas.style.height = `${this.height}px`;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ratio = ratio;
    this.ask();
  }
  show(view) {
    this.view = view;
    this.canvas.closest(".globe").classList.toggle("flat", view === "map");
    this.resize(this.canvas.parentElement.clientWidth);
  }
  ask() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }
  get radius() { return (Math.min(this.width, this.height) / 2 - 8) * this.zoom; }
  basis() {
    const cy = Math.cos(this.yaw * RAD), sy = Math.sin(this.yaw * RAD), cp = Math.cos(this.pitch * RAD), sp = Math.sin(this.pitch * RAD);
    return { ahead: [cp * cy, cp * sy, -sp], right: [-sy, cy, 0], down: [sp * cy, sp * sy, cp] };
  }
  /* The canvas position of a direction; null if it is not visible. */
  place(d, basis) {
    if (this.view === "map") {
      return [this.width / 2 + (wrap(azimuthOf(d) - this.yaw) / 360) * this.width, (this.height / 180) * (90 - elevationOf(d))];
    }
    const dot = (a) => a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
    if (dot(basis.ahead) < 0) return null;
    return [this.width / 2 + this.radius * dot(basis.right), this.height / 2 + this.radius * dot(basis.down)];
  }
  at(x, y) {
    if (this.view === "map") {
      return direction(90 - (y / this.height) * 180, wrap(this.yaw + ((x - this.width / 2) / this.width) * 360));
    }
    const u = (x - this.width / 2) / this.radius, v = (y - this.height / 2) / this.radius, n = u * u + v * v;
    if (n > 1) return null;
    const { ahead, right, down } = this.basis(), w = Math.sqrt(1 - n);
    return [0, 1, 2].map((k) => w * ahead[k] + u * right[k] + v * down[k]);
  }
  shotAt(d) {
    let best = null, deepest = 0;
    for (const shot of shots) {
      const inside = depth(shot, d);
      if (inside > deepest) { deepest = inside; best = shot; }
    }
    return best;
  }
  draw() {
    const { context: c, ratio } = this, basis = this.basis();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.width, this.height);
    this.drawTexture(basis);
    this.drawGrid(basis);
    const ink = this.paint === "photos" ? "rgba(255,255,255,.75)" : colour("ink");
    const looks = { first: ink, retaken: colour("warn"), patch: colour("patch"), bridge: colour("accent"), missing: colour("bad") };
    c.lineJoin = "round";
    for (const shot of shots) {
      const dense = shots.length > 60;
      c.lineWidth = shot.kind === "first" ? (dense ? 0.8 : 1.1) : 1.9;
      c.globalAlpha = shot.kind === "first" ? 0.8 : 1;
      c.strokeStyle = looks[shot.kind];
      c.setLineDash(shot.kind === "missing" ? [5, 4] : []);
      this.line(shot.outline, basis);
      if (this.paint === "coverage") this.dot(shot.boresight, basis, looks[shot.kind], dense ? 1.6 : 2.4);
    }
    c.globalAlpha = 1;
    c.setLineDash([]);
    this.drawTies(basis);
    this.drawHoles(basis);
    if (chosen.shot) {
      c.lineWidth = 4.5; c.strokeStyle = "rgba(0,0,0,.45)"; this.line(chosen.shot.outline, basis);
      c.lineWidth = 2.6; c.strokeStyle = "#ffd54a"; this.line(chosen.shot.outline, basis);
      this.dot(chosen.shot.boresight, basis, "#ffd54a", 4.5);
    }
    const state = this.canvas.dataset;
    state.yaw = this.yaw.toFixed(2); state.pitch = this.pitch.toFixed(2); state.view = this.view; state.paint = this.paint;
    state.shot = chosen.shot ? chosen.shot.i : "";
  }
  /* Which photos their content ties to each other; ties without which a group falls apart are marked. */
  drawTies(basis) {
    const content = data.certificate && data.certificate.content;
    if (!content || !content.checked) return;
    const c = this.context, places = new Map(shots.map((shot) => [shot.i, shot.boresight]));
    const bridges = new Set(content.bridges.map(([a, b]) => `${Math.min(a, b)}-${Math.max(a, b)}`));
    for (const [a, b] of content.ties) {
      const from = places.get(a), to = places.get(b);
      if (!from || !to) continue;
      const bridge = bridges.has(`${Math.min(a, b)}-${Math.max(a, b)}`);
      c.lineWidth = bridge ? 2.2 : 0.9;
      c.globalAlpha = bridge ? 1 : 0.55;
      c.strokeStyle = bridge ? colour("warn") : colour("good");
      this.line([...Array(9).keys()].map((k) => {
        const d = [0, 1, 2].map((axis) => from[axis] + (k / 8) * (to[axis] - from[axis])), n = Math.hypot(...d) || 1;
        return d.map((x) => x / n);
      }), basis);
    }
    c.globalAlpha = 1;
    for (const i of content.geometry_only) if (places.has(i)) this.dot(places.get(i), basis, colour("warn"), 4);
    this.canvas.dataset.ties = content.ties.length;
  }
  drawTexture({ ahead, right, down }) {
    const texture = this.textures[this.paint], scale = this.drag ? 0.6 : Math.min(1.5, this.ratio);
    if (this.view === "map") {
      const sheet = this.asCanvas(texture), shift = ((this.yaw % 360) / 360) * this.width;
      for (const k of [-2, -1, 0, 1, 2]) this.context.drawImage(sheet, k * this.width - shift, 0, this.width, this.height);
      return;
    }
    const w = Math.round(this.width * scale), h = Math.round(this.height * scale), r = this.radius * scale;
    const image = this.context.createImageData(w, h), out = image.data, { width, height, pixels } = texture;
    const kx = width / (2 * Math.PI), ky = height / Math.PI;
    for (let j = 0; j < h; j += 1) {
      const v = (j + 0.5 - h / 2) / r, v2 = v * v;
      if (v2 >= 1) continue;
      const half = Math.sqrt(1 - v2) * r, from = Math.max(0, Math.ceil(w / 2 - half)), to = Math.min(w, Math.floor(w / 2 + half));
      for (let i = from; i < to; i += 1) {
        const u = (i + 0.5 - w / 2) / r, z = Math.sqrt(Math.max(0, 1 - u * u - v2));
        const x = z * ahead[0] + u * right[0] + v * down[0], y = z * ahead[1] + u * right[1] + v * down[1];
        const s = z * ahead[2] + u * right[2] + v * down[2];
        const column = Math.min(width - 1, ((Math.atan2(y, x) + Math.PI) * kx) | 0);
        const row = Math.min(height - 1, ((Math.asin(s < -1 ? -1 : s > 1 ? 1 : s) + Math.PI / 2) * ky) | 0);
        const p = 4 * (row * width + column), q = 4 * (j * w + i), light = 0.72 + 0.28 * z;
        out[q] = pixels[p] * light; out[q + 1] = pixels[p + 1] * light; out[q + 2] = pixels[p + 2] * light; out[q + 3] = 255;
      }
    }
    this.sheet.width = w; this.sheet.height = h;
    this.sheet.getContext("2d").putImageData(image, 0, 0);
    this.context.imageSmoothingEnabled = true;
    this.context.drawImage(this.sheet, 0, 0, this.width, this.height);
    this.context.beginPath();
    this.context.arc(this.width / 2, this.height / 2, this.radius, 0, 2 * Math.PI);
    this.context.strokeStyle = colour("line"); this.context.lineWidth = 1.5;
    this.context.stroke();
  }
  asCanvas(texture) {
    if (!texture.sheet) {
      texture.sheet = el("canvas", { width: texture.width, height: texture.height });
      texture.sheet.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(texture.pixels), texture.width, texture.height), 0, 0);
    }
    return texture.sheet;
  }
  drawGrid(basis) {
    const c = this.context, light = this.paint === "photos";
    c.lineWidth = 0.7;
    c.strokeStyle = light ? "rgba(255,255,255,.28)" : colour("muted");
    c.globalAlpha = light ? 1 : 0.35;
    const steps = [...Array(61).keys()];
    for (let a = -180; a < 180; a += 30) this.line(steps.map((k) => direction(-90 + 3 * k, a)), basis);
    for (const e of [-60, -30, 30, 60]) this.line(steps.map((k) => direction(e, -180 + 6 * k)), basis);
    c.lineWidth = 1.6; c.globalAlpha = light ? 1 : 0.7;
    this.line(steps.map((k) => direction(0, -180 + 6 * k)), basis);
    c.globalAlpha = 1;
    c.font = "600 12px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "middle";
    const north = (data.mission.reference.yaw_north_deg || 0);
    const names = [["N", 0], ["E", 90], ["S", 180], ["W", -90]];
    for (const [name, heading] of names) this.label(name, direction(0, heading - north), basis);
    this.label("nadir", direction(-90, 0), basis);
    this.label("zenith", direction(90, 0), basis);
  }
  label(text, d, basis) {
    const p = this.place(d, basis), c = this.context;
    if (!p || (this.view === "map" && text.length > 1)) return;
    c.lineWidth = 3.5; c.strokeStyle = this.paint === "photos" ? "rgba(0,0,0,.65)" : colour("card"); c.strokeText(text, ...p);
    c.fillStyle = this.paint === "photos" ? "#fff" : colour("ink"); c.fillText(text, ...p);
  }
  line(points, basis) {
    const c = this.context;
    let before = null;
    c.beginPath();
    for (const d of points) {
      const p = this.place(d, basis);
      const cut = !p || !before || (this.view === "map" && Math.abs(p[0] - before[0]) > this.width / 2);
      if (p) { if (cut) c.moveTo(...p); else c.lineTo(...p); }
      before = p;
    }
    c.stroke();
  }
  dot(d, basis, style, size) {
    const p = this.place(d, basis);
    if (!p) return;
    this.context.fillStyle = style;
    this.context.beginPath(); this.context.arc(p[0], p[1], size, 0, 2 * Math.PI); this.context.fill();
  }
  drawHoles(basis) {
    const c = this.context;
    for (const hole of (data.certificate && data.certificate.holes) || []) {
      const p = this.place(direction(hole.elevation_deg, hole.azimuth_deg), basis);
      // large holes are visible themselves; a small one gets a mark
      if (!p || hole.size_deg > 12) continue;
      const size = Math.max(7, (hole.size_deg / 2) * RAD * this.radius);
      c.strokeStyle = colour("c0"); c.lineWidth = 2.5;
      c.beginPath(); c.arc(p[0], p[1], size, 0, 2 * Math.PI); c.stroke();
    }
  }
  turn(yaw, pitch) {
    this.yaw = wrap(this.yaw + yaw);
    this.pitch = Math.max(-90, Math.min(90, this.pitch + pitch));
    this.ask();
  }
  zoomBy(factor) { this.zoom = Math.max(1, Math.min(6, this.zoom * factor)); this.ask(); }
  listen() {
    const { canvas } = this;
    const where = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      this.drag = { at: [event.clientX, event.clientY], moved: false };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const d = this.drag;
      if (d) {
        const dx = event.clientX - d.at[0], dy = event.clientY - d.at[1];
        if (!d.moved && Math.hypot(dx, dy) < 5) return;
        d.moved = true; d.at = [event.clientX, event.clientY];
        canvas.classList.add("turning");
        const per = this.view === "map" ? 360 / this.width : 1 / RAD / this.radius;
        this.turn(-dx * per, this.view === "map" ? 0 : dy * per);
        return;
      }
      const found = this.at(...where(event));
      choose(found && this.shotAt(found));
    });
    const end = (event) => {
      const d = this.drag;
      this.drag = null;
      canvas.classList.remove("turning");
      if (d && !d.moved && event.type === "pointerup") {
        const found = this.at(...where(event)), shot = found && this.shotAt(found);
        choose(shot, { pin: shot !== null && !(chosen.pinned && chosen.shot === shot) });
        if (!shot) { chosen.pinned = false; choose(null); }
      }
      this.ask();
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => { if (!this.drag) choose(null); });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10] };
      if (steps[event.key]) this.turn(...steps[event.key]);
      else if (event.key === "+") this.zoomBy(1.3);
      else if (event.key === "-") this.zoomBy(1 / 1.3);
      else return;
      event.preventDefault();
    });
  }
}
