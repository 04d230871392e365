/* Builds the page. */
"use strict";
const { mission, counts, certificate, timeline, photos, stitch } = data;
const STATES = { complete: "good", incomplete: "warn", paused: "warn", aborted: "bad", failed: "bad" };
const pill = (text, kind) => el("span", { class: `pill ${kind || ""}` }, text);

/* The duration of a simulated mission is that of its vehicle's clock; beside it the time that people waited. */
function lived() {
  if (!isNumber(timeline.lived_s)) return null;
  return timeline.simulated ? `${seconds(timeline.lived_s)} of simulated time` + (timeline.pace > 0 ? `, ${seconds(timeline.lived_s / timeline.pace)} on the clock` : "") : seconds(timeline.lived_s);
}

function head() {
  const place = mission.position, spot = isNumber(place.latitude_deg)
    ? `${Math.abs(place.latitude_deg).toFixed(5)}° ${place.latitude_deg < 0 ? "S" : "N"}, ${Math.abs(place.longitude_deg).toFixed(5)}° ${place.longitude_deg < 0 ? "W" : "E"}` : null;
  document.getElementById("head").append(
    el("h1", {}, mission.name ? `${mission.name} (${mission.id})` : `Mission ${mission.id}`), pill(mission.state, STATES[mission.state]),
    el("p", {}, [mission.reason, when(mission.times.started), data.camera.name, spot].filter(Boolean).join(" · ")),
  );
}

function tile(name, value, more, kind) {
  return el("div", { class: "tile" }, el("div", { class: "name" }, name), el("div", { class: `value ${kind ? `${kind}-text` : ""}` }, value), el("div", { class: "more" }, more || ""));
}
function tiles() {
  const done = counts.shots_done === counts.shots_total, rejected = data.reasons.reduce((sum, [, n]) => sum + n, 0);
  const taken = shots.filter((shot) => shot.taken && shot.taken.error);
  let worst = null;
  for (const shot of taken) {
    AXES.forEach((axis, k) => {
      const share = Math.abs(shot.taken.error[k]) / data.tolerance_deg[axis];
      if (isNumber(share) && (!worst || share > worst.share)) worst = { share, axis, value: shot.taken.error[k] };
    });
  }
  const { samples } = data.battery, last = samples.length ? samples[samples.length - 1][1] : null;
  const whole = certificate ? 1 - certificate.uncovered_fraction : null;
  const brokenOff = attempts.filter((item) => item.verdict === "interrupted").length;
  const tried = rejected ? `${plural(rejected, "attempt")} rejected` : brokenOff ? `none rejected, ${brokenOff} interrupted` : "every first attempt was accepted";
  const ratio = isNumber(timeline.limit_s) && timeline.limit_s > 0 ? timeline.duration_s / timeline.limit_s : null;
  document.getElementById("tiles").append(
    tile("shots", [String(counts.shots_done), el("small", {}, ` of ${counts.shots_total}`)], done ? "all accepted" : `${counts.shots_total - counts.shots_done} missing`, done ? "good" : "bad"),
    tile("coverage", percent(whole, 2), certificate ? (certificate.certified ? "certified as flown" : "not certified") : "not certified: the mission has not ended", certificate ? (whole === 1 ? "good" : "bad") : ""),
    tile("retakes", String(counts.retakes), tried),
    tile("worst accepted error", worst ? `${Math.round(100 * worst.share)} %` : "–", worst ? `of τ: ${worst.axis} ${signed(worst.value)}` : "no measured attitude", worst && worst.share > 1 ? "warn" : ""),
    tile(timeline.simulated ? "shooting time, simulated" : "shooting time", seconds(timeline.duration_s), ratio ? `${ratio.toFixed(2)} × the physical limit` : "physical limit unknown"),
    tile("battery", percent(last, 0), samples.length > 1 ? `from ${percent(samples[0][1], 0)}` : "no history"),
  );
}

function shotCard(shot) {
  if (!shot) {
    return [el("h3", {}, "Footprints"), el("p", {}, shots.length ? "Hover over a footprint to see its data; click to select it. Drag or use the arrow keys to rotate, + and − to zoom." : "The mission has no shots."), el("div", { class: "steps" }, stepButtons(null))];
  }
  const [pitch, yaw] = shot.target, taken = shot.taken, north = mission.reference.yaw_north_deg || 0;
  const kinds = { accepted: "good", missed: "bad", skipped: "warn" };
  const pose = (p, y) => `pitch ${degrees(p)}, yaw ${degrees(y)}` + (north ? ` (true ${degrees(((y + north) % 360 + 360) % 360)})` : "");
  const rows = [["target", pose(pitch, yaw)]];
  if (taken && taken.pose) rows.push(["measured", `${pose(taken.pose[0], taken.pose[2])}, roll ${degrees(taken.pose[1])}`]);
  if (taken && taken.error) AXES.forEach((axis, k) => rows.push([`${axis} error`, [`${signed(taken.error[k])} of ±${data.tolerance_deg[axis]}°`, errorBar(taken.error[k], data.tolerance_deg[axis])]]));
  if (taken) rows.push(["evidence", taken.evidence.replaceAll("_", " ")]);
  if (taken && taken.by && taken.by !== "tolerance") rows.push(["accepted by", taken.by.replaceAll("_", " ")]);
  if (shot.photo) rows.push(["photo", photoLink(shot.photo)]);
  if (!taken && shot.reason) rows.push(["reason", shot.reason]);
  const others = shot.attempts.filter((attempt) => attempt !== taken);
  return [
    el("h3", {}, el("span", {}, `Shot ${shot.i}${shot.patch ? ", a patch" : shot.bridge ? `, a bridge between ${shot.bridge.join(" and ")}` : ""}`), pill(taken ? (taken.n > 1 ? `accepted at attempt ${taken.n}` : "accepted") : shot.status, taken ? "good" : kinds[shot.status])),
    facts([...rows, ...others.map((attempt) => [`attempt ${attempt.n}`, `${attempt.verdict}${attempt.reason ? `: ${attempt.reason}` : ""}`])]),
    el("div", { class: "steps" }, stepButtons(shot)),
  ];
}
function errorBar(value, tau) {
  const share = Math.max(-1, Math.min(1, value / tau / 1.5)), width = Math.max(1.5, 50 * Math.abs(share));
  return el("div", { class: "bar" }, el("i", { class: Math.abs(value) > tau ? "over" : "", style: { left: `${share < 0 ? 50 - width : 50}%`, width: `${width}%` } }));
}
function photoLink(photo) {
  const name = photo.name || "not named";
  return photo.href ? el("a", { href: photo.href, target: "_blank", rel: "noopener" }, name) : `${name} ${photo.problem}`;
}
function stepButtons(shot) {
  const order = shots.map((s) => s.i), at = shot ? order.indexOf(shot.i) : -1;
  const go = (k) => choose(byIndex.get(order[(k + order.length) % order.length]), { pin: true, show: true });
  const buttons = [el("button", { class: "plain", "data-step": "previous", onclick: () => go(at < 0 ? -1 : at - 1) }, "← previous"), el("button", { class: "plain", "data-step": "next", onclick: () => go(at + 1) }, "next →")];
  if (shot && chosen.pinned) buttons.push(el("button", { class: "plain", "data-step": "let-go", onclick: () => { chosen.pinned = false; choose(null); } }, "let go"));
  return order.length ? buttons : [];
}

/* One line of a certificate; `ok` is null for what is neither good nor bad. */
function check(ok, text, more) {
  const looks = ok === null ? ["", "–"] : ok ? ["good-text", "✓"] : ["bad-text", "✗"];
  return el("div", { class: "check" }, el("b", { class: looks[0] }, looks[1]), el("span", {}, text, more ? el("small", {}, more) : null));
}

/* What the content of the photos proves, beside the geometry. */
function content(found) {
  if (!found) return [];
  if (!found.checked) return [check(null, "The content of the photos is unchecked", found.reason)];
  const names = (list) => list.slice(0, 12).join(", ") + (list.length > 12 ? " …" : "");
  return [
    check(!found.bad.length, found.bad.length ? `${plural(found.bad.length, "photo")} do not count for their content` : "Every examined photo is readable, exposed, sharp and where its attitude says", found.bad.length ? found.bad.slice(0, 12).map((bad) => `shot ${bad.shot}: ${bad.code}`).join(", ") : null),
    check(found.connected, found.connected ? `${plural(found.ties.length, "tie")} connect the photos` : `The photos are tied in ${found.groups} groups that only geometry connects`, found.bridges.length ? `${plural(found.bridges.length, "tie")} would part them if lost` : null),
    ...(found.bridge_shots || []).map(({ shot, between, ties }) => check(ties.length === 2 ? true : null, `Bridge shot ${shot} ties ${ties.length === 2 ? `shots ${between.join(" and ")}` : ties.length ? `shot ${ties[0]} alone, not shot ${between.find((end) => end !== ties[0])}` : `neither shot ${between.join(" nor ")}`}`, null)),
    found.geometry_only.length ? check(null, `${plural(found.geometry_only.length, "photo")} are proved by geometry only${isNumber(found.geometry_bound_deg) ? `, within ${degrees(found.geometry_bound_deg)}` : ""}`, `nothing in their overlaps can be tied: shot ${names(found.geometry_only)}`) : null,
    found.unchecked.length ? check(null, `The content of ${plural(found.unchecked.length, "photo")} is unchecked`, `shot ${names(found.unchecked)}`) : null,
  ];
}

function sphere() {
  const canvas = el("canvas", { id: "ball", tabindex: 0, role: "img", "aria-label": "Map of the sphere with the footprint of every shot; arrow keys turn it" });
  const details = el("div", { class: "shot-card", "aria-live": "polite" });
  const toolbar = el("div", { class: "toolbar" }), legend = el("div", { class: "legend" });
  card("sphere", "Sphere map", "The footprints at the measured attitudes. The sphere is seen from inside, so photos are not mirrored.",
    toolbar, el("div", { class: "globe" }, el("div", {}, canvas, legend), details));
  const map = new SphereMap(canvas);
  const entry = (text, name, stroke) => el("span", { class: stroke ? "stroke" : "", style: { "--swatch": `var(--${name})` } }, text);
  const relabel = () => {
    const found = certificate && certificate.content && certificate.content.checked ? certificate.content : null;
    const kinds = new Set(shots.map((shot) => shot.kind)), gap = certificate ? certificate.uncovered_fraction > 0 : true;
    legend.replaceChildren(...[
      ...(map.paint === "coverage" ? [1, 2, 3].map((k) => entry(plural(k, "image"), `c${k}`)).concat(entry("4 or more", "c4"), gap ? entry("gap", "c0") : null, entry("outside the band", "outside")) : []),
      kinds.has("retaken") ? entry("accepted after a retake", "warn", true) : null, kinds.has("patch") ? entry("patch shot", "patch", true) : null, kinds.has("bridge") ? entry("bridge shot", "accent", true) : null,
      found && found.ties.length ? entry("tie between photos", "tie") : null, found && found.bridges.length ? entry("tie without which a group falls apart", "lone-tie") : null,
      found && found.geometry_only.length ? entry("by geometry only", "warn") : null,
      kinds.has("missing") ? entry("missing", "bad", true) : null,
    ].filter(Boolean));
  };
  const choice = (key, options, act) => {
    const buttons = options.map(([value, text]) => el("button", { "data-choice": value, onclick: () => { act(value); refresh(); } }, text));
    const refresh = () => { buttons.forEach((b) => b.setAttribute("aria-pressed", String(map[key] === b.dataset.choice))); relabel(); };
    refresh();
    return el("span", { class: "toggle" }, buttons);
  };
  const refill = () => {
    toolbar.replaceChildren(
      choice("view", [["ball", "Sphere"], ["map", "Flat map"]], (value) => map.show(value)),
      map.textures.photos ? choice("paint", [["photos", "Photos"], ["coverage", "Coverage"]], (value) => map.paintWith(value)) : "",
      el("span", { class: "toggle" }, el("button", { "aria-label": "zoom out", onclick: () => map.zoomBy(1 / 1.3) }, "−"), el("button", { "aria-label": "zoom in", onclick: () => map.zoomBy(1.3) }, "+")),
    );
  };
  refill();
  chosen.listeners.push((shot) => {
    // the button that was pressed is made anew: the keyboard stays on it
    const step = details.contains(document.activeElement) ? document.activeElement.dataset.step : null;
    details.replaceChildren(...shotCard(shot));
    if (step) (details.querySelector(`[data-step="${step}"]`) || details.querySelector("[data-step]")).focus({ preventScroll: true });
  });
  details.replaceChildren(...shotCard(null));
  return { usePicture: (image) => { map.usePicture(image); refill(); } };
}

function proof() {
  if (!certificate) {
    card("certificate", "Certificate", "The panorama as flown was not certified: the mission ended before.");
    return;
  }
  const overlap = (value, asked) => asked === undefined || value >= asked || certificate.certified;
  const [h, v] = data.band.overlap || [undefined, undefined];
  card("certificate", "Certificate of the panorama as flown", "Computed exactly from the measured attitudes, without sampling.",
    el("p", {}, pill(certificate.certified ? "certified" : "not certified", certificate.certified ? "good" : "bad"), ` ${plural(certificate.images, "image")}`),
    check(certificate.uncovered_fraction === 0, certificate.uncovered_fraction === 0 ? "Every direction of the band is covered" : `${percent(1 - certificate.uncovered_fraction, 3)} of the band is covered`, certificate.holes.length ? `${plural(certificate.holes.length, "hole")}, the largest ${degrees(certificate.holes[0].size_deg)} across` : null),
    isNumber(certificate.min_overlap_h) && check(overlap(certificate.min_overlap_h, h), `Horizontal overlap is at least ${percent(certificate.min_overlap_h)}`, h === undefined ? null : `required: ${percent(h)}`),
    isNumber(certificate.min_overlap_v) && check(overlap(certificate.min_overlap_v, v), `Vertical overlap is at least ${percent(certificate.min_overlap_v)}`, v === undefined ? null : `required: ${percent(v)}`),
    check(certificate.connected, certificate.connected ? "The overlap graph is connected" : "The overlap graph is not connected"),
    check(certificate.two_edge_connected, certificate.two_edge_connected ? "It stays connected without any single overlap" : `${plural(certificate.bridges.length, "overlap")} would disconnect the graph if lost`),
    certificate.failures.length ? el("ul", { class: "texts" }, certificate.failures.map((text) => el("li", {}, text))) : null,
    ...content(certificate.content),
    data.parallax && check(null, `Seams of up to ${data.parallax.worst_px.toFixed(0)} px are expected on the ground from the drift`, `shots ${data.parallax.between.join(" and ")}`));
}

function retakes() {
  const bad = attempts.filter((item) => item.verdict === "rejected" || item.verdict === "interrupted");
  if (!bad.length) {
    card("retakes", "Retakes", counts.attempts ? "None: every attempt was accepted." : "There were no attempts.");
    return;
  }
  card("retakes", "Rejected and interrupted attempts", `${plural(counts.attempts, "attempt")} at ${plural(counts.shots_total, "shot")}, ${plural(counts.retakes, "retake")}.`,
    el("div", {}, data.reasons.map(([code, n]) => [pill(`${n} × ${words(code)}`, "bad"), " "])),
    el("div", { class: "scroll" }, el("table", {}, el("thead", {}, el("tr", {}, el("th", { class: "num" }, "shot"), el("th", { class: "num" }, "attempt"), el("th", {}, "reason"))),
      el("tbody", {}, bad.map((item) => el("tr", { class: "hit" }, el("td", { class: "num" }, String(item.shot.i)), el("td", { class: "num" }, String(item.n)), el("td", {}, item.reason || item.verdict)))))));
}

function photoProblems() {
  const texts = [...data.notes];
  if (data.panorama.left_out && data.panorama.left_out.length) texts.push(`not in the quick look: ${data.panorama.left_out.join(", ")}`);
  if (!photos.problems.length && !photos.absent && !texts.length && data.panorama.kind) return;
  card("photos", "Photos", `${photos.usable} of ${photos.accepted} accepted photos are in the mission's directory and complete.`,
    photos.absent ? el("p", { class: "lead" }, `${photos.absent[0].toUpperCase()}${photos.absent.slice(1)}`) : null,
    photos.problems.length ? el("div", { class: "scroll" }, el("table", {}, el("tbody", {}, photos.problems.map((p) => el("tr", {}, el("th", {}, `shot ${p.shot}`), el("td", {}, `${p.name || "photo"} ${p.problem}`)))))) : null,
    data.panorama.kind ? null : el("p", { class: "lead" }, `No panorama: ${data.panorama.why}.`),
    texts.length ? el("ul", { class: "texts" }, texts.map((text) => el("li", {}, text))) : null);
}

function stitching() {
  if (!stitch) return;
  const c = stitch.completeness, untied = stitch.untied || [];
  card("stitching", "Stitching", null, facts([
    ["completeness", `${percent(c.fraction, 2)} of the ground (equation 8)`], ["photos", `${stitch.images} stitched, ${untied.length} without control points`],
    ["without control points", untied.join(", ")], ["alignment", `${stitch.points} points, ${isNumber(stitch.rms_px) ? stitch.rms_px.toFixed(2) : "–"} px rms`],
    ["panorama", stitch.canvas_px ? `${stitch.canvas_px[0]} × ${stitch.canvas_px[1]} px` : null],
    ["time", Object.entries(stitch.seconds || {}).map(([step, s]) => `${step} ${seconds(s)}`).join(", ")],
  ]));
}

function batteryAndFacts() {
  const holder = el("div", {});
  if (data.battery.samples.length) {
    card("battery", "Battery", null, holder);
    drawBattery(holder);
  } else card("battery", "Battery", "The vehicle reported no charge.");
  const { hfov_deg: h, vfov_deg: v, image_px: px } = data.camera, tau = data.tolerance_deg;
  card("facts", "Mission", null, facts([
    ["started", when(mission.times.started)], ["finished", when(mission.times.finished)], ["duration", lived()],
    ["restarts", mission.times.restarts ? String(mission.times.restarts) : null],
    ["camera", `${data.camera.name}, ${degrees(h, 1)} × ${degrees(v, 1)}, ${px[0]} × ${px[1]} px`],
    ["tolerance τ", `pitch ±${tau.pitch}°, roll ±${tau.roll}°, yaw ±${tau.yaw}°`],
    ["band", data.band.known ? `elevation ${degrees(data.band.elevation[0], 1)} to ${degrees(data.band.elevation[1], 1)}` : null],
    ["yaw 0", mission.reference.kind === "heading" ? `the heading at the start, ${degrees(mission.reference.yaw_north_deg, 1)} from north` : "true north"],
    ...Object.entries(mission.vehicle).map(([key, value]) => [key.replaceAll("_", " "), String(value)]),
  ]), mission.warnings.length ? el("ul", { class: "texts" }, mission.warnings.map((text) => el("li", {}, text))) : null,
  mission.open_loop ? el("p", { class: "lead" }, "Flown without attitude feedback: poses are assumed, not measured.") : null);
}

function main() {
  head();
  tiles();
  const ball = sphere(), source = panoramaImage();
  if (source) {
    showPanorama(source);
    const image = new Image();
    image.onload = () => ball.usePicture(image);
    image.src = source;
  }
  const legend = (entries) => el("div", { class: "legend" }, entries.map(([text, name]) => el("span", { style: { "--swatch": `var(--${name})` } }, text)));
  const points = el("div", {});
  if (attempts.some((item) => item.error)) {
    card("pointing", "Pointing error of every attempt", "The largest error of each exposure, measured minus target. The green band is the tolerance τ; open red marks are rejected attempts, triangles are beyond the scale.", points);
    drawPointing(points);
  } else card("pointing", "Pointing error of every attempt", "No attempt has a measured attitude.");
  const totals = el("div", {}), columns = el("div", {});
  if (attempts.some((item) => item.times)) {
    card("timeline", "Time by phase", "Each column is one attempt; the horizontal line is its physical limit: the least time that gimbal, settle time, exposure and camera interval allow. Red dots are rejected attempts.", totals,
      legend([["slew", "slew"], ["settle", "settle"], ["expose", "expose"], ["wait", "wait"], ...(timeline.totals_s.paused ? [["paused", "paused"]] : [])]), columns,
      el("p", { class: "lead", style: { margin: "8px 0 0" } }, "Measured: start, settled, end of the exposure. The slew is computed as the least possible time; the rest before the trigger counts as settling, or as waiting if the camera's interval ended last." + (Math.abs(timeline.pace - 1) > 0.05 ? ` Simulated time: a simulated second took ${(1 / timeline.pace).toFixed(timeline.pace > 5 ? 2 : 1)} s.` : "")));
    drawTotals(totals);
    drawTimeline(columns);
  } else card("timeline", "Time by phase", "No attempt has begun.");
  proof();
  retakes();
  photoProblems();
  stitching();
  batteryAndFacts();
  document.getElementById("foot").textContent = `Written by panoexec ${data.made.version}, ${when(data.made.time.replace("+00:00", "Z"))}.` + (data.panorama.kind ? " Panorama viewer: Pannellum (MIT licence)." : "");
  document.documentElement.dataset.ready = "yes";
}
main();
