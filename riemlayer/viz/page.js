"use strict";
// The page around the drawings: camera, hands, buttons, titles and colour bars.
const FOCAL = 1 / Math.tan(Math.PI / 12);
const { centre, extent, direction, up, fit } = scene.view;
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const away = Math.max(1.55 * fit * FOCAL, 1.2 * extent);
const home = () => ({ rows: [cross(up, direction), up, direction], distance: away });
let camera = home(), shown = [0], drawings = [], frames = 0;
let swaying = !matchMedia("(prefers-reduced-motion: reduce)").matches, last = 0, start = 0;
function rotate(about, angle) {  // rows of the matrix turn about an axis of the screen
  const [a, b] = [[1, 2], [2, 0]][about], c = Math.cos(angle), s = Math.sin(angle), r = camera.rows;
  [r[a], r[b]] = [r[a].map((x, i) => c * x - s * r[b][i]), r[b].map((x, i) => c * x + s * r[a][i])];
}
function zoom(factor) {
  camera.distance = Math.min(2.5 * away, Math.max(0.1 * away, camera.distance * factor));
}

// ---- frames: all panels share the camera
const focal = (w, h) => FOCAL * Math.min(1, w / h);
function columns() {  // as many as leave the panels largest
  const n = shown.length, w = canvas.clientWidth, h = canvas.clientHeight;
  const side = c => Math.min(w / c, h / Math.ceil(n / c));
  return [...Array(n).keys()].map(i => i + 1).reduce((best, c) => side(c) > side(best) ? c : best);
}
function draw() {
  const ratio = Math.min(devicePixelRatio || 1, 2), across = columns(), r = camera.rows;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  const w = Math.floor(width / across), h = Math.floor(height / Math.ceil(shown.length / across));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  document.getElementById("panels").style.gridTemplateColumns = `repeat(${across}, 1fr)`;
  gl.clearColor(1, 1, 1, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  const turn = [0, 1, 2].flatMap(i => [r[0][i], r[1][i], r[2][i]]), thin = ratio * Math.min(1, Math.min(w, h) / ratio / 400);
  shown.forEach((i, panel) => {
    gl.viewport(panel % across * w, height - (Math.floor(panel / across) + 1) * h, w, h);
    drawPanel(drawings[i], { turn, centre, lens: [camera.distance, extent, focal(w, h), w / h] }, [w, h], thin);
  });
  document.body.dataset.frames = ++frames;
}
function frame(time) {
  if (swaying) {
    rotate(1, 0.3 * (Math.sin((time - start) / 3000) - Math.sin((last - start) / 3000)));
    last = time;
    requestAnimationFrame(frame);
  }
  draw();
}
let asked = false;
function redraw() {
  swaying = false;
  if (!asked) requestAnimationFrame(() => { asked = false; draw(); });
  asked = true;
}

// ---- hands
const fingers = new Map();
let grab = () => false;  // the viewer's own use of a drag
canvas.onpointerdown = e => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); };
canvas.onpointerup = canvas.onpointercancel = e => fingers.delete(e.pointerId);
canvas.onpointermove = e => {
  if (!fingers.has(e.pointerId) || grab(e)) return;
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
  const [x, y] = fingers.get(e.pointerId), before = fingers.size === 2 ? spread() : 0;
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  if (fingers.size === 2) zoom(before / Math.max(spread(), 1));
  else { rotate(1, (e.clientX - x) * -0.008); rotate(0, (e.clientY - y) * 0.008); }
  redraw();
};
canvas.onwheel = e => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); redraw(); };
canvas.ondblclick = () => { camera = home(); redraw(); };
onkeydown = e => {
  const act = { ArrowLeft: () => rotate(1, 0.1), ArrowRight: () => rotate(1, -0.1), ArrowUp: () => rotate(0, -0.1),
                ArrowDown: () => rotate(0, 0.1), "+": () => zoom(0.9), "-": () => zoom(1.1), Home: () => { camera = home(); } }[e.key];
  if (act) { e.preventDefault(); act(); redraw(); }
};
onresize = () => requestAnimationFrame(draw);

// ---- titles, colour bars, buttons
function element(tag, parent, text = "") {
  const e = document.createElement(tag);
  e.textContent = text;
  parent.append(e);
  return e;
}
function addBar(cell, d) {
  const bar = element("div", cell), strip = element("i", bar), ticks = element("span", bar);
  bar.className = "bar";
  strip.style.background = `linear-gradient(to right, ${scene.bar.join(", ")})`;
  const ends = [d.ticks[0], d.ticks[d.ticks.length - 1]];
  for (const tick of shown.length > 3 ? ends : d.ticks) element("small", ticks, tick);
  element("em", bar, d.label);
}
function show(list) {
  shown = list;
  const panels = document.getElementById("panels");
  panels.replaceChildren();
  for (const i of list) {
    const cell = element("div", panels);
    if (list.length > 1) element("b", cell, drawings[i].title);
    if (drawings[i].pattern === 3) addBar(cell, drawings[i]);
  }
  for (const b of document.querySelectorAll("header button")) b.setAttribute("aria-pressed", b.dataset.list === list.join());
  requestAnimationFrame(draw);
}
function addButton(text, list) {
  const b = element("button", document.querySelector("header div"), text);
  b.dataset.list = list.join();
  b.onclick = () => show(list);
}

// ---- start
document.title = document.querySelector("h1").textContent = scene.title;
document.querySelector("header p").textContent = gl ? scene.note : "This page needs a browser with WebGL 2.";
if (gl) {
  programs = { surface: program(SURFACE_VERTEX, SURFACE_FRAGMENT), line: program(LINE_VERTEX, FLAT_FRAGMENT),
               mark: program(MARK_VERTEX, FLAT_FRAGMENT) };
  drawings = scene.drawings.map(upload);
  const every = [...drawings.keys()];
  drawings.forEach((d, i) => addButton(d.title || String(i + 1), [i]));
  if (every.length > 1) addButton("side by side", every);
  show([0]);
  canvas.addEventListener("webglcontextlost", e => e.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => location.reload());
  requestAnimationFrame(time => { start = last = time; frame(time); });
}
