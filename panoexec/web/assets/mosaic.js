/* The photos laid on the sphere: an equirectangular texture that takes thumbnails as they arrive.

   Each pixel shows the photo in which it is nearest to the middle, so the order of arrival makes no difference. */
import { rgb } from "/assets/pages/elements.js";
import { RAD, azimuthOf, boresightOf, elevationOf, matrix } from "/assets/pages/sphere_math.js";

const WIDTH = 1536, HEIGHT = WIDTH / 2;
const NONE = -1;
const AHEAD = 5;
const WORK_MS = 60;

export class Mosaic {
  /* changed: called after each photo that was laid on. */
  constructor(changed) {
    this.changed = changed;
    this.pixels = new Uint8ClampedArray(4 * WIDTH * HEIGHT);
    this.words = new Uint32Array(this.pixels.buffer);
    this.depths = new Float32Array(WIDTH * HEIGHT);
    this.owners = new Int32Array(WIDTH * HEIGHT).fill(NONE);
    this.texture = { width: WIDTH, height: HEIGHT, pixels: this.pixels, sheet: null, version: 0 };
    this.cosines = Float64Array.from({ length: WIDTH }, (_, k) => Math.cos((((k + 0.5) / WIDTH) * 360 - 180) * RAD));
    this.sines = Float64Array.from({ length: WIDTH }, (_, k) => Math.sin((((k + 0.5) / WIDTH) * 360 - 180) * RAD));
    this.photos = new Map();
    this.queue = [];
    this.laid = 0;
    this.busy = false;
    this.band = null;
    this.ground();
  }
  renewed() {
    this.texture.sheet = null;
    this.texture.version += 1;
  }
  /* The bare sphere: the band that is asked for, and what is outside. */
  ground(band = this.band) {
    this.band = band;
    const word = (name) => { const [r, g, b] = rgb(name); return (0xff000000 | (b << 16) | (g << 8) | r) >>> 0; };
    const asked = word("c1"), outside = word("outside");
    // the columns of the sector; it may cross the border of the map
    const first = band ? Math.ceil(((band.azimuth[0] + 180) / 360) * WIDTH - 0.5) : 0, last = band ? Math.floor(((band.azimuth[1] + 180) / 360) * WIDTH - 0.5) : WIDTH - 1;
    const line = new Uint32Array(WIDTH).fill(outside);
    for (let k = first; k <= Math.min(last, first + WIDTH - 1); k += 1) line[((k % WIDTH) + WIDTH) % WIDTH] = asked;
    const bare = new Uint32Array(WIDTH).fill(outside);
    for (let row = 0; row < HEIGHT; row += 1) {
      const elevation = 90 - ((row + 0.5) / HEIGHT) * 180, start = row * WIDTH;
      const source = !band || (elevation >= band.elevation[0] && elevation <= band.elevation[1]) ? line : bare;
      if (!this.laid) { this.words.set(source, start); continue; }
      for (let column = 0; column < WIDTH; column += 1) if (this.owners[start + column] === NONE) this.words[start + column] = source[column];
    }
    this.renewed();
    this.changed();
  }
  clear() {
    if (this.laid) {
      this.owners.fill(NONE);
      this.depths.fill(0);
      this.laid = 0;
    }
    this.photos.clear();
    this.queue = [];
    this.ground();
  }
  /* Shows the photos of the shots that have one; those that changed are laid on again. */
  show(shots, camera) {
    if (!camera) return;
    const wanted = new Map();
    for (const shot of shots) {
      const taken = shot.attempts.find((attempt) => attempt.n === shot.accepted);
      if (!shot.url || !taken) continue;
      const q = taken.q || shot.q;
      if (q) wanted.set(shot.i, { i: shot.i, url: shot.url, q, key: `${shot.url} ${q.join(" ")}`, camera });
    }
    const gone = [...this.photos.keys()].filter((i) => !wanted.has(i));
    if (gone.length) this.takeAway(gone);
    for (const [i, photo] of wanted) {
      if (this.photos.get(i)?.key === photo.key) continue;
      // a newer photo of the same shot covers the older one, wherever its neighbours do not
      if (this.photos.has(i)) for (let k = 0; k < this.owners.length; k += 1) if (this.owners[k] === i) this.depths[k] = 0;
      this.photos.set(i, photo);
      this.queue.push(photo);
    }
    this.work();
  }
  /* Photos that do not count any more leave bare ground, or what their neighbours show there. */
  takeAway(gone) {
    const lost = new Set(gone);
    for (let k = 0; k < this.owners.length; k += 1) if (lost.has(this.owners[k])) { this.owners[k] = NONE; this.depths[k] = 0; }
    const axes = gone.map((i) => boresightOf(matrix(this.photos.get(i).q)));
    for (const i of gone) this.photos.delete(i);
    this.ground();
    for (const photo of this.photos.values()) {
      const { half_width: w, half_height: h } = photo.camera, near = Math.cos(Math.min(Math.PI, 2 * Math.atan(Math.hypot(w, h)))), axis = boresightOf(matrix(photo.q));
      if (!this.queue.includes(photo) && axes.some((one) => one.reduce((sum, x, k) => sum + x * axis[k], 0) > near)) this.queue.push(photo);
    }
  }
  async work() {
    if (this.busy) return;
    this.busy = true;
    let begun = performance.now();
    while (this.queue.length) {
      const photo = this.queue.shift();
      if (this.photos.get(photo.i) !== photo) continue;
      // the next ones are on their way meanwhile
      for (const next of [photo, ...this.queue.slice(0, AHEAD)]) next.image ??= load(next.url);
      const image = await photo.image;
      photo.image = null;
      if (!image) { this.photos.delete(photo.i); continue; }
      if (this.photos.get(photo.i) !== photo) continue;
      this.lay(photo, image);
      this.laid += 1;
      this.renewed();
      this.changed(photo.i);
      // many at once after the page was opened, each at once as it arrives
      if (this.queue.length && performance.now() - begun < WORK_MS) continue;
      await new Promise(requestAnimationFrame);
      begun = performance.now();
    }
    this.busy = false;
  }
  lay(photo, image) {
    const { width: w, height: h, data } = image, source = new Uint32Array(data.buffer), m = matrix(photo.q);
    const { half_width: hw, half_height: hh } = photo.camera, axis = boresightOf(m);
    const reach = Math.atan(Math.hypot(hw, hh)) / RAD, level = elevationOf(axis), middle = azimuthOf(axis);
    for (let row = 0; row < HEIGHT; row += 1) {
      const elevation = 90 - ((row + 0.5) / HEIGHT) * 180;
      if (Math.abs(elevation - level) > reach) continue;
      // the azimuths that a circle of `reach` around the boresight has at this elevation
      const c = Math.cos(elevation * RAD) * Math.cos(level * RAD);
      const cosine = c > 1e-9 ? (Math.cos(reach * RAD) - Math.sin(elevation * RAD) * Math.sin(level * RAD)) / c : -1;
      const spread = cosine <= -1 ? 180 : cosine >= 1 ? 0 : Math.acos(cosine) / RAD;
      const flat = Math.cos(elevation * RAD), down = -Math.sin(elevation * RAD);
      const from = Math.floor(((middle - spread + 180) / 360) * WIDTH), to = Math.min(from + WIDTH - 1, Math.ceil(((middle + spread + 180) / 360) * WIDTH));
      for (let k = from; k <= to; k += 1) {
        const column = ((k % WIDTH) + WIDTH) % WIDTH, place = row * WIDTH + column;
        const dx = flat * this.cosines[column], dy = flat * this.sines[column];
        const x = m[0][0] * dx + m[1][0] * dy + m[2][0] * down;
        let depth = -1, across = 0, along = 0;
        if (x > 0) {
          across = (m[0][1] * dx + m[1][1] * dy + m[2][1] * down) / x / hw;
          along = (m[0][2] * dx + m[1][2] * dy + m[2][2] * down) / x / hh;
          depth = 1 - Math.max(Math.abs(across), Math.abs(along));
        }
        const owner = this.owners[place];
        if (depth < 0 || (owner !== NONE && owner !== photo.i && this.depths[place] >= depth)) continue;
        const u = Math.min(w - 1, ((across + 1) * 0.5 * w) | 0), v = Math.min(h - 1, ((along + 1) * 0.5 * h) | 0);
        this.words[place] = source[v * w + u];
        this.depths[place] = depth;
        this.owners[place] = photo.i;
      }
    }
  }
}

/* The pixels of a thumbnail, or null. */
async function load(url) {
  try {
    const image = new Image();
    image.src = url;
    await image.decode();
    const sheet = document.createElement("canvas");
    sheet.width = image.naturalWidth; sheet.height = image.naturalHeight;
    const context = sheet.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0);
    return context.getImageData(0, 0, sheet.width, sheet.height);
  } catch { return null; }
}
