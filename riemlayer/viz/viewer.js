"use strict";
// The viewer: a click on the shape chooses the source, and the server answers with new drawings.
const FIXED = scene.fixed;  // arrays of the shape stay; those of an answer come after them
const STILL = 4;  // pixels within which a press counts as a click

// ---- where the eye's ray through a pixel meets the shape: {at} on a mesh, {point} of a cloud
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
function ray(x, y) {
  const across = columns(), w = canvas.clientWidth / across, h = canvas.clientHeight / Math.ceil(shown.length / across);
  const f = focal(w, h), r = camera.rows, u = (2 * (x % w) / w - 1) * w / h / f, v = (1 - 2 * (y % h) / h) / f;
  const along = [0, 1, 2].map(i => u * r[0][i] + v * r[1][i] - r[2][i]);
  return { from: centre.map((c, i) => c + camera.distance * r[2][i]), along };
}
function pickMesh({ from, along }, points, faces) {
  let nearest = Infinity;
  for (let f = 0; f < faces.length; f += 3) {
    const [i, j, k] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const e = [points[j] - points[i], points[j + 1] - points[i + 1], points[j + 2] - points[i + 2]];
    const g = [points[k] - points[i], points[k + 1] - points[i + 1], points[k + 2] - points[i + 2]];
    const h = cross(along, g), det = dot(e, h);
    if (Math.abs(det) < 1e-20) continue;
    const s = [from[0] - points[i], from[1] - points[i + 1], from[2] - points[i + 2]], u = dot(s, h) / det;
    if (u < 0 || u > 1) continue;
    const q = cross(s, e), v = dot(along, q) / det;
    if (v < 0 || u + v > 1) continue;
    const t = dot(g, q) / det;
    if (t > 0 && t < nearest) nearest = t;
  }
  return nearest < Infinity ? { at: from.map((x, i) => x + nearest * along[i]) } : null;
}
function pickCloud({ from, along }, points, normals, sizes) {
  let nearest = Infinity, best = -1;
  for (let i = 0; i < sizes.length; i++) {
    const n = [normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]], falls = dot(along, n);
    if (Math.abs(falls) < 1e-20) continue;
    const s = [points[3 * i] - from[0], points[3 * i + 1] - from[1], points[3 * i + 2] - from[2]];
    const t = dot(s, n) / falls, off = s.map((x, k) => x - t * along[k]);
    const deep = t + 0.5 * dot(off, off) / sizes[i];  // the same cones as on the screen
    if (t > 0 && dot(off, off) < sizes[i] ** 2 && deep < nearest) [nearest, best] = [deep, i];
  }
  return best < 0 ? null : { point: best };
}
function pick(x, y) {
  const d = drawings[shown[0]], points = new Float32Array(bytes(d.point));
  if (d.faces !== null) return pickMesh(ray(x, y), points, new Uint32Array(bytes(d.faces)));
  return pickCloud(ray(x, y), points, new Float32Array(bytes(d.normal)), new Float32Array(bytes(d.size)));
}

// ---- ask the server, one question at a time; of those that wait, the last is asked
let busy = false, waiting = null;
const say = text => { document.querySelector("header p").textContent = text; };
async function ask(where) {
  if (busy) { waiting = where; return; }
  busy = true;
  try {
    const response = await fetch("drawings?" + new URLSearchParams(where));
    const answer = await response.json();
    if (response.ok) update(answer);
    say(response.ok ? scene.note : answer.error);
  } catch (error) {
    say("The viewer's server does not answer; start it again.");
  }
  busy = false;
  const next = waiting;
  waiting = null;
  if (next) ask(next);
}
function update(answer) {
  scene.arrays.length = FIXED;
  for (const index of [...cache.keys()]) if (index >= FIXED) cache.delete(index);
  scene.arrays.push(...answer.arrays);
  drawings = drawings.map((old, i) => { release(old); return upload({ ...old, ...answer.drawings[i] }); });
  document.body.dataset.source = answer.p.join();
  redraw();
}

// ---- hands: a click, or a drag with the shift key
let pressed = null;
canvas.addEventListener("pointerdown", e => { pressed = [e.clientX, e.clientY]; });
canvas.addEventListener("pointerup", e => {
  const still = pressed && Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) < STILL;
  const where = still && fingers.size === 0 ? pick(e.offsetX, e.offsetY) : null;
  if (where) ask(where);
});
grab = e => {
  if (!e.shiftKey) return false;
  const where = pick(e.offsetX, e.offsetY);
  if (where) ask(where);
  return true;
};
