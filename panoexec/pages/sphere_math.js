/* Geometry of the sphere. Camera frame: x boresight, y right, z down; world: x yaw 0, y 90° clockwise, z down. */
"use strict";
export const RAD = Math.PI / 180;

/* The rotation of a unit quaternion [w, x, y, z], camera to world. */
export function matrix([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
/* The rotation of a level camera, degrees. */
export function levelMatrix(pitch, yaw) {
  const cy = Math.cos(yaw * RAD), sy = Math.sin(yaw * RAD), cp = Math.cos(pitch * RAD), sp = Math.sin(pitch * RAD);
  return [[cp * cy, -sy, sp * cy], [cp * sy, cy, sp * sy], [-sp, 0, cp]];
}
export const turned = (m, [x, y, z]) => m.map((row) => row[0] * x + row[1] * y + row[2] * z);
export const boresightOf = (m) => m.map((row) => row[0]);
export function direction(elevation, azimuth) {
  const c = Math.cos(elevation * RAD);
  return [c * Math.cos(azimuth * RAD), c * Math.sin(azimuth * RAD), -Math.sin(elevation * RAD)];
}
export const elevationOf = (d) => Math.atan2(-d[2], Math.hypot(d[0], d[1])) / RAD;
export const azimuthOf = (d) => Math.atan2(d[1], d[0]) / RAD;
export const wrap = (angle) => ((angle + 180) % 360 + 360) % 360 - 180;
/* Whether an azimuth is in the sector that runs clockwise from one to the other. */
export const inSector = (azimuth, from, to) => ((azimuth - from) % 360 + 360) % 360 <= to - from;

/* The border of a footprint as directions, closed; half sizes are tangents. */
export function outlineOf(m, halfWidth, halfHeight, steps = 12) {
  const corners = [[-halfWidth, -halfHeight], [halfWidth, -halfHeight], [halfWidth, halfHeight], [-halfWidth, halfHeight]];
  const outline = [];
  corners.forEach(([y0, z0], i) => {
    const [y1, z1] = corners[(i + 1) % 4];
    for (let k = 0; k < steps; k += 1) {
      const y = y0 + ((y1 - y0) * k) / steps, z = z0 + ((z1 - z0) * k) / steps, n = Math.hypot(1, y, z);
      outline.push(turned(m, [1 / n, y / n, z / n]));
    }
  });
  outline.push(outline[0]);
  return outline;
}
/* Position of a direction in a footprint: 0 at its border, 1 at its centre, negative outside. */
export function depthIn(m, halfWidth, halfHeight, d) {
  const x = m[0][0] * d[0] + m[1][0] * d[1] + m[2][0] * d[2];
  if (x <= 0) return -1;
  const y = m[0][1] * d[0] + m[1][1] * d[1] + m[2][1] * d[2], z = m[0][2] * d[0] + m[1][2] * d[1] + m[2][2] * d[2];
  return 1 - Math.max(Math.abs(y / x) / halfWidth, Math.abs(z / x) / halfHeight);
}
/* The shorter arc between two directions, as directions. */
export function arc(from, to, steps = 8) {
  return Array.from({ length: steps + 1 }, (_, k) => {
    const d = [0, 1, 2].map((axis) => from[axis] + (k / steps) * (to[axis] - from[axis])), n = Math.hypot(...d) || 1;
    return d.map((x) => x / n);
  });
}
/* A circle of `radius` degrees around a direction. */
export function circleAround(d, radius, steps = 36) {
  const flat = Math.hypot(d[0], d[1]), right = flat > 1e-6 ? [-d[1] / flat, d[0] / flat, 0] : [0, 1, 0];
  const down = [d[1] * right[2] - d[2] * right[1], d[2] * right[0] - d[0] * right[2], d[0] * right[1] - d[1] * right[0]];
  const c = Math.cos(radius * RAD), s = Math.sin(radius * RAD);
  return Array.from({ length: steps + 1 }, (_, k) => {
    const a = (2 * Math.PI * k) / steps;
    return [0, 1, 2].map((axis) => c * d[axis] + s * (Math.cos(a) * right[axis] + Math.sin(a) * down[axis]));
  });
}
