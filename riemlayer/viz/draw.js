"use strict";
// Draws the scene of the page with WebGL 2: surfaces, lines, marks.
const scene = JSON.parse(document.getElementById("scene").textContent);
const canvas = document.querySelector("canvas");
const gl = canvas.getContext("webgl2", { antialias: true });

// ---- shaders: one camera, one light at the viewer, colours worked out for every pixel
const CAMERA = `
  uniform mat3 turn; uniform vec3 centre; uniform vec4 lens;  // distance, extent, focal length, width / height
  float near() { return max(lens.x - 1.5 * lens.y, 0.02 * lens.y); }
  float far() { return lens.x + 1.5 * lens.y; }
  vec3 seen(vec3 x) { return turn * (x - centre) - vec3(0, 0, lens.x); }
  vec4 project(vec3 s) {
    return vec4(lens.z / lens.w * s.x, lens.z * s.y,
                (-s.z * (far() + near()) - 2.0 * far() * near()) / (far() - near()), -s.z);
  }`;
const SURFACE_VERTEX = `#version 300 es
  in vec3 point; in vec3 normal; in vec2 log; in float value; in float valid; in vec3 tint;
  in vec2 corner; in float size; in vec3 slope0; in vec3 slope1; in vec3 bend0; in vec3 bend1; in vec3 bend2; in vec3 rim;
  out vec2 x; out float v; out float ok; out vec3 t; out vec3 n; out vec3 place; out vec3 eye; out vec4 disc; out float deep;
  ${CAMERA}
  void main() {  // a vertex of a mesh (size = 0), or a corner of the square around a disc in the tangent plane
    vec3 a = normalize(cross(normal, abs(normal.x) < 0.7 ? vec3(1, 0, 0) : vec3(0, 1, 0)) + 1e-9);
    vec3 offset = size * (corner.x * a + corner.y * cross(normal, a));
    place = point + offset; eye = seen(place);
    gl_Position = project(eye);
    x = log + vec2(dot(slope0, offset), dot(slope1, offset)); v = (value + dot(slope0, offset)) * valid; ok = valid; t = tint;
    n = turn * (normal + vec3(dot(bend0, offset), dot(bend1, offset), dot(bend2, offset)));
    disc = vec4(corner, size, dot(rim, offset));
    deep = 0.5 * size * far() * near() / ((far() - near()) * eye.z * eye.z);
  }`;
const SURFACE_FRAGMENT = `#version 300 es
  precision highp float;
  in vec2 x; in float v; in float ok; in vec3 t; in vec3 n; in vec3 place; in vec3 eye; in vec4 disc; in float deep; out vec4 colour;
  uniform int pattern; uniform float radius, period, low, high; uniform vec3 blue, cream, plain, map0, map1, map2;
  ${document.getElementById("surface").textContent}
  void main() {  // discs are cones to the depth test: each shows its part of a Voronoi diagram
    vec3 base = surface_colour(x, v, ok, t, place), across = cross(dFdx(eye), dFdy(eye)), along = normalize(eye);
    vec3 normal = facing(n, across, along);
    if (outside(disc, normal, along)) discard;
    gl_FragDepth = gl_FragCoord.z + deep * dot(disc.xy, disc.xy);
    colour = vec4(base * brightness(normal, along), 1.0);
  }`;
const LINE_VERTEX = `#version 300 es
  in vec3 begin; in vec3 end; in vec2 corner;
  uniform vec2 screen; uniform float width, lift;
  ${CAMERA}
  void main() {  // a strip of fixed width on the screen, lifted a little towards the eye
    vec4 a = project(seen(begin)), b = project(seen(end)), c = corner.x < 0.5 ? a : b;
    vec2 along = (b.xy / b.w - a.xy / a.w) * screen;
    along = length(along) > 1e-6 ? normalize(along) : vec2(1, 0);
    vec2 out_ = vec2(-along.y, along.x) * corner.y + along * (2.0 * corner.x - 1.0) * 0.5;
    gl_Position = c + vec4(out_ * width / screen * c.w, -lift * c.w, 0);
  }`;
const MARK_VERTEX = `#version 300 es
  in vec3 point; uniform float pixels;
  ${CAMERA}
  void main() {
    vec4 c = project(seen(point));
    gl_Position = c - vec4(0, 0, 0.012 * c.w, 0);
    gl_PointSize = pixels;
  }`;
const FLAT_FRAGMENT = `#version 300 es
  precision highp float;
  uniform vec3 ink; uniform bool disc; uniform float rim; out vec4 colour;
  void main() {
    float r = disc ? length(gl_PointCoord - 0.5) : 0.0;
    if (r > 0.5) discard;
    colour = vec4(r > rim ? vec3(1) : ink, 1.0);
  }`;

function program(vertex, fragment) {
  const p = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw Error(gl.getShaderInfoLog(shader));
    gl.attachShader(p, shader);
  }
  gl.linkProgram(p);
  return p;
}
let programs;

// ---- data
const cache = new Map();
function bytes(index) {
  if (!cache.has(index)) cache.set(index, Uint8Array.from(atob(scene.arrays[index]), c => c.charCodeAt(0)).buffer);
  return cache.get(index);
}
let made = [];  // buffers of the drawing that is being uploaded
function buffer(data, target = gl.ARRAY_BUFFER) {
  const b = gl.createBuffer();
  made.push(b);
  gl.bindBuffer(target, b);
  gl.bufferData(target, data, gl.STATIC_DRAW);
  return b;
}
function attribute(p, name, b, size, stride = 0, offset = 0, divisor = 0) {
  const at = gl.getAttribLocation(p, name);
  gl.bindBuffer(gl.ARRAY_BUFFER, b);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, gl.FLOAT, false, stride, offset);
  gl.vertexAttribDivisor(at, divisor);
}
const SQUARE = new Float32Array([-1, -1, -1, 1, 1, -1, 1, 1]);
function uploadSurface(d) {
  const vao = gl.createVertexArray(), each = d.faces === null ? 1 : 0;
  gl.bindVertexArray(vao);
  const widths = { point: 3, normal: 3, log: 2, value: 1, valid: 1, tint: 3, size: 1, rim: 3 };
  for (const [name, width] of Object.entries(widths)) {
    if (d[name] !== null) attribute(programs.surface, name, buffer(bytes(d[name])), width, 0, 0, each);
  }
  for (const [name, rows] of [["slope", 2], ["bend", 3]]) {
    if (d[name] === null) continue;
    const b = buffer(bytes(d[name]));
    for (let i = 0; i < rows; i++) attribute(programs.surface, name + i, b, 3, 12 * rows, 12 * i, each);
  }
  if (each) attribute(programs.surface, "corner", buffer(SQUARE), 2);
  else buffer(bytes(d.faces), gl.ELEMENT_ARRAY_BUFFER);
  return { vao, discs: each ? bytes(d.point).byteLength / 12 : 0, indices: each ? 0 : bytes(d.faces).byteLength / 4 };
}
function uploadLines(index, look) {
  const data = bytes(index), vao = gl.createVertexArray();
  gl.bindVertexArray(vao);
  const b = buffer(data);
  attribute(programs.line, "begin", b, 3, 24, 0, 1);
  attribute(programs.line, "end", b, 3, 24, 12, 1);
  attribute(programs.line, "corner", buffer(new Float32Array([0, -1, 0, 1, 1, -1, 1, 1])), 2);
  return { vao, count: data.byteLength / 24, ...look };
}
function uploadMarks(index, look) {
  const data = bytes(index), vao = gl.createVertexArray();
  gl.bindVertexArray(vao);
  attribute(programs.mark, "point", buffer(data), 3);
  return { vao, count: data.byteLength / 12, ...look };
}
function upload(d) {
  const looks = [{ ink: "black", width: 1.5, lift: 0.006 }, { ink: "orange", width: 2.5, lift: 0.008 }];
  made = [];
  const drawing = {
    ...d,
    made,
    surface: uploadSurface(d),
    lines: [uploadLines(d.reference, looks[0]), uploadLines(d.paths, looks[1])],
    marks: [[d.dots, { pixels: 2, ink: "dot", rim: 1 }], [d.p, { pixels: 13, ink: "black", rim: 0.38 }]]
      .filter(([index]) => index !== null).map(([index, look]) => uploadMarks(index, look)),
  };
  gl.bindVertexArray(null);
  return drawing;
}
function release(d) {
  for (const x of [d.surface, ...d.lines, ...d.marks]) gl.deleteVertexArray(x.vao);
  d.made.forEach(b => gl.deleteBuffer(b));
}

// ---- one panel
function uniforms(p, values) {
  gl.useProgram(p);
  const put = { 1: "uniform1f", 2: "uniform2fv", 3: "uniform3fv", 4: "uniform4fv" };
  for (const [name, v] of Object.entries(values)) {
    const at = gl.getUniformLocation(p, name);
    if (v.length === 9) gl.uniformMatrix3fv(at, false, v);
    else if (typeof v === "boolean" || name === "pattern") gl.uniform1i(at, Number(v));
    else gl[put[v.length || 1]](at, v);
  }
}
function drawPanel(d, eye, size, ratio) {
  const c = scene.colours, s = d.surface, [map0, map1, map2] = scene.map;
  const { pattern, radius, period, low, high } = d, { blue, cream, plain } = c;
  uniforms(programs.surface, { ...eye, pattern, radius, period, low, high, blue, cream, plain, map0, map1, map2 });
  gl.vertexAttrib1f(gl.getAttribLocation(programs.surface, "valid"), 1);
  gl.bindVertexArray(s.vao);
  if (s.indices) gl.drawElements(gl.TRIANGLES, s.indices, gl.UNSIGNED_INT, 0);
  else gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, s.discs);
  for (const line of d.lines) {
    uniforms(programs.line, { ...eye, screen: size, width: line.width * ratio, lift: line.lift, ink: c[line.ink], disc: false, rim: 1 });
    gl.bindVertexArray(line.vao);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, line.count);
  }
  for (const mark of d.marks) {
    uniforms(programs.mark, { ...eye, pixels: Math.max(mark.pixels * ratio, 1), ink: c[mark.ink], disc: true, rim: mark.rim });
    gl.bindVertexArray(mark.vao);
    gl.drawArrays(gl.POINTS, 0, mark.count);
  }
}
