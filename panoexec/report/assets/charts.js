/* SVG charts of the available width: pointing errors, time by phase, battery. */
"use strict";
const AXES = ["pitch", "roll", "yaw"];

function attemptText(item) {
  const lines = [`shot ${item.shot.i}, attempt ${item.n}: ${item.verdict}`];
  if (item.reason) lines.push(item.reason);
  if (item.error) lines.push(AXES.map((axis, k) => `${axis} ${signed(item.error[k])}`).join("  "));
  return lines.join("\n");
}
function reacts(node, item, text) {
  node.addEventListener("pointerenter", (event) => { showTip(event, text); choose(item.shot); });
  node.addEventListener("pointermove", (event) => showTip(event, text));
  node.addEventListener("pointerleave", () => { hideTip(); choose(null); });
  node.addEventListener("click", () => choose(item.shot, { pin: true, show: true }));
  return node;
}

function drawPointing(holder) {
  const judged = attempts.filter((item) => item.error);
  responsive(holder, (width) => {
    const left = 52, right = 10, height = 104, gap = 20, top = 16;
    const total = top + 3 * (height + gap) + 10;
    const root = svg("svg", { viewBox: `0 0 ${width} ${total}`, height: total, role: "img", "aria-label": "Pointing error of every attempt by axis" });
    const x = (k) => left + ((k + 0.5) / Math.max(1, judged.length)) * (width - left - right);
    AXES.forEach((axis, a) => {
      const tau = data.tolerance_deg[axis], reach = 1.75 * tau;
      const y0 = top + a * (height + gap) + height / 2, y = (value) => y0 - (value / reach) * (height / 2);
      root.append(
        svg("rect", { class: "tau", x: left, width: width - left - right, y: y(tau), height: y(-tau) - y(tau) }),
        svg("line", { class: "axis", x1: left, x2: width - right, y1: y0, y2: y0 }),
        ...[tau, -tau].map((v) => svg("line", { class: "edge", x1: left, x2: width - right, y1: y(v), y2: y(v) })),
        ...[tau, -tau].map((v) => svg("text", { x: left - 7, y: y(v) + 4, "text-anchor": "end" }, `${v > 0 ? "+" : "\u2212"}${tau}°`)),
        svg("text", { x: left - 7, y: y0 + 4, "text-anchor": "end", style: { "font-weight": 600 } }, axis),
      );
      judged.forEach((item, k) => {
        const value = item.error[a];
        if (!isNumber(value)) return;
        const out = Math.abs(value) > reach, place = y(Math.max(-reach, Math.min(reach, value)));
        const over = Math.abs(value) > tau, ink = item.verdict === "accepted" ? (over ? "var(--warn)" : "var(--accent)") : "var(--bad)";
        const size = judged.length > 120 ? 2.4 : 3.4, s = Math.sign(value);
        const mark = out
          ? svg("path", { d: `M${x(k) - 4.5},${place + 5 * s}h9l-4.5,${-8 * s}z`, fill: ink })
          : svg("circle", { cx: x(k), cy: place, r: size, fill: item.verdict === "accepted" ? ink : "none", stroke: ink, "stroke-width": 1.6 });
        mark.setAttribute("class", "hit mark");
        root.append(reacts(mark, item, attemptText(item)));
      });
    });
    root.append(svg("text", { x: width - right, y: total - 4, "text-anchor": "end" }, "attempts in the order taken →"));
    holder.replaceChildren(root);
  });
}

const PHASES = [
  ["slew", "slewing"], ["settle", "settling"], ["wait", "waiting for the camera"], ["expose", "exposing"], ["after", "after the photo"], ["paused", "paused"],
];
const phaseColour = (name) => `var(--${name === "after" ? "wait" : name})`;

function drawTotals(holder) {
  const { totals_s: totals, duration_s: duration, limit_s: limit } = data.timeline;
  responsive(holder, (width) => {
    const left = width < 560 ? 84 : 120, right = 62, scale = (width - left - right) / Math.max(duration, limit || 0, 1e-9);
    const root = svg("svg", { viewBox: `0 0 ${width} 76`, height: 76, role: "img", "aria-label": "Time by phase and physical limit" });
    let x = left;
    for (const name of ["slew", "settle", "wait", "expose", "paused"]) {
      const w = (totals[name] || 0) * scale, text = `${name}: ${seconds(totals[name])}`;
      const bar = svg("rect", { x, y: 6, width: Math.max(0, w), height: 24, fill: phaseColour(name) });
      bar.addEventListener("pointermove", (event) => showTip(event, text));
      bar.addEventListener("pointerleave", hideTip);
      root.append(bar);
      x += w;
    }
    root.append(svg("text", { x: left - 8, y: 22, "text-anchor": "end" }, "as flown"), svg("text", { x: x + 8, y: 22 }, seconds(duration)));
    if (isNumber(limit)) {
      root.append(
        svg("rect", { x: left, y: 42, width: limit * scale, height: 24, rx: 2, fill: "none", stroke: "var(--ink)", "stroke-width": 1.4 }),
        svg("text", { x: left - 8, y: 58, "text-anchor": "end" }, "limit"),
        svg("text", { x: left + limit * scale + 8, y: 58 }, seconds(limit)),
      );
    }
    holder.replaceChildren(root);
  });
}

function drawTimeline(holder) {
  const timed = attempts.filter((item) => item.times);
  const length = (t) => t.slew + t.settle + t.wait + t.expose + t.after - t.paused;
  const sorted = timed.map((item) => length(item.times)).sort((a, b) => a - b);
  const tall = sorted.length ? Math.min(sorted[sorted.length - 1], 2.2 * sorted[Math.floor(0.9 * (sorted.length - 1))] + 0.5) : 1;
  responsive(holder, (width) => {
    const left = 52, right = 10, height = 190, top = 12, base = top + height;
    const root = svg("svg", { viewBox: `0 0 ${width} ${base + 26}`, height: base + 26, role: "img", "aria-label": "Time of every attempt by phase" });
    const y = (value) => base - (Math.min(value, tall) / tall) * height, each = (width - left - right) / Math.max(1, timed.length);
    const steps = [0.5, 1, 2, 5, 10, 20, 50, 100], step = steps.find((s) => tall / s <= 5) || 200;
    for (let v = 0; v <= tall; v += step) {
      root.append(
        svg("line", { class: "grid", x1: left, x2: width - right, y1: y(v), y2: y(v) }),
        svg("text", { x: left - 7, y: y(v) + 4, "text-anchor": "end" }, `${v} s`),
      );
    }
    timed.forEach((item, k) => {
      const t = item.times, x = left + k * each, w = Math.max(0.6, each - (each > 5 ? 2 : 0.4));
      const group = svg("g", { class: "hit" });
      let from = 0;
      for (const [name] of PHASES) {
        const spent = name === "after" ? t.after - t.paused : name === "paused" ? 0 : t[name];
        if (!(spent > 0)) continue;
        group.append(svg("rect", { x, width: w, y: y(from + spent), height: Math.max(0, y(from) - y(from + spent)), fill: phaseColour(name) }));
        from += spent;
      }
      if (t.paused > 0) group.append(svg("path", { d: `M${x + w + 0.5},${top}V${base}`, stroke: "var(--paused)", "stroke-width": 3, "stroke-dasharray": "6 4" }));
      if (from > tall) group.append(svg("path", { d: `M${x},${top}l${w / 2},-7l${w / 2},7z`, fill: "var(--muted)" }));
      if (item.verdict === "rejected") group.append(svg("circle", { cx: x + w / 2, cy: base + 9, r: Math.min(3.4, Math.max(1.6, w / 2)), fill: "var(--bad)" }));
      if (t.limit > 0) group.append(svg("line", { class: "limit", x1: x - 0.5, x2: x + w + 0.5, y1: y(t.limit), y2: y(t.limit) }));
      const text = [attemptText(item), ...PHASES.map(([name, word]) => {
        const spent = name === "after" ? t.after - t.paused : t[name];
        return spent > 0.005 ? `${word} ${seconds(spent)}` : null;
      }), t.limit > 0 ? `physical limit ${seconds(t.limit)}` : "a retake: not part of the physical limit"];
      root.append(reacts(group, item, text.filter(Boolean).join("\n")));
    });
    root.append(svg("line", { class: "axis", x1: left, x2: width - right, y1: base, y2: base }));
    holder.replaceChildren(root);
  });
}

function drawBattery(holder) {
  const { samples, floor } = data.battery;
  responsive(holder, (width) => {
    const left = 46, right = 8, height = 130, top = 8, base = top + height;
    const span = Math.max(1, samples[samples.length - 1][0]);
    const x = (t) => left + (t / span) * (width - left - right), y = (v) => base - v * height;
    const root = svg("svg", { viewBox: `0 0 ${width} ${base + 22}`, height: base + 22, role: "img", "aria-label": "Battery charge over the mission" });
    for (const v of [0, 0.5, 1]) {
      root.append(
        svg("line", { class: "grid", x1: left, x2: width - right, y1: y(v), y2: y(v) }),
        svg("text", { x: left - 7, y: y(v) + 4, "text-anchor": "end" }, `${100 * v} %`),
      );
    }
    if (isNumber(floor) && floor > 0) {
      root.append(
        svg("line", { x1: left, x2: width - right, y1: y(floor), y2: y(floor), stroke: "var(--bad)", "stroke-dasharray": "5 4" }),
        svg("text", { x: width - right, y: y(floor) - 5, "text-anchor": "end" }, `floor ${percent(floor, 0)}`),
      );
    }
    const line = samples.map(([t, v], k) => `${k ? "L" : "M"}${x(t).toFixed(1)},${y(v).toFixed(1)}`).join("") + (samples.length === 1 ? `H${width - right}` : "");
    root.append(
      svg("path", { d: `${line}V${base}H${left}Z`, fill: "var(--accent)", opacity: 0.12 }),
      svg("path", { d: line, fill: "none", stroke: "var(--accent)", "stroke-width": 2.2, "stroke-linejoin": "round" }),
      svg("text", { x: left, y: base + 17 }, "start"),
      svg("text", { x: width - right, y: base + 17, "text-anchor": "end" }, seconds(span * data.timeline.pace)),
    );
    holder.replaceChildren(root);
  });
}
