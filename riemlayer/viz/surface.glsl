// The colour of one pixel of a surface: shared by pictures (VTK) and pages (WebGL 2).
// Needs pattern, radius, period, low, high, blue, cream, plain, map0, map1 and map2. The same in
// closed form is in tiles.py and palette.py.

const float PI = 3.14159265;
const float SECTORS = 16.0;
const float STEEPEST = 3.0;
const float CONTOUR = 0.12;  // discs seen more edge-on than that would fray the contour

// A square wave of period 2, averaged over a pixel that is `width` wide.
float wave(float t, float width) {
  return clamp(sin(PI * t) / (PI * width + 1e-6), -1.0, 1.0);
}

float checkerboard(vec2 x) {
  vec2 t = x / period, width = fwidth(t);
  return wave(t.x, width.x) * wave(t.y, width.y);
}

float polar_grid(vec2 x) {
  float r = length(x), ring = r / period;
  // the angle jumps at its seam, so its width on the screen comes from that of x
  vec2 across = vec2(-x.y, x.x) / max(r * r, 1e-12);
  float width = abs(dot(across, dFdx(x))) + abs(dot(across, dFdy(x)));
  float per = SECTORS / (2.0 * PI);
  return wave(ring, fwidth(ring)) * wave(atan(x.y, x.x) * per, width * per);
}

vec3 colour_map(float t) {
  t = clamp(t, 0.0, 1.0);
  vec3 lab = mix(mix(map0, map1, t), mix(map1, map2, t), t);
  vec3 lms = vec3(lab.x + 0.3963377774 * lab.y + 0.2158037573 * lab.z,
                  lab.x - 0.1055613458 * lab.y - 0.0638541728 * lab.z,
                  lab.x - 0.0894841775 * lab.y - 1.2914855480 * lab.z);
  lms = lms * lms * lms;
  vec3 rgb = clamp(vec3(4.0767416621 * lms.x - 3.3077115913 * lms.y + 0.2309699292 * lms.z,
                        -1.2684380046 * lms.x + 2.6097574011 * lms.y - 0.3413193965 * lms.z,
                        -0.0041960863 * lms.x - 0.7034186147 * lms.y + 1.7076147010 * lms.z), 0.0, 1.0);
  return mix(12.92 * rgb, 1.055 * pow(rgb, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, rgb));
}

// x: tangent coordinates; value: on the colour map, times valid; valid: below 1/2 nothing is drawn;
// tint: own colour; place: in the world.
vec3 surface_colour(vec2 x, float value, float valid, vec3 tint, vec3 place) {
  // derivatives first: they must not stand behind a branch
  float soft = fwidth(length(x)) + 1e-6, edge = fwidth(valid) + 1e-6;
  float board = checkerboard(x), rings = polar_grid(x);
  float stretch = max(length(dFdx(x)) / (length(dFdx(place)) + 1e-9),
                      length(dFdy(x)) / (length(dFdy(place)) + 1e-9));
  float shown = smoothstep(-0.5, 0.5, (valid - 0.5) / edge);
  if (pattern == 0) return plain;
  if (pattern == 3) return mix(plain, colour_map((value / max(valid, 1e-6) - low) / max(high - low, 1e-30)), shown);
  if (pattern == 4) return mix(plain, tint, shown);
  shown *= (1.0 - smoothstep(-0.5, 0.5, (length(x) - radius) / soft)) * step(stretch, STEEPEST);
  float tile = 0.5 + 0.5 * (pattern == 2 ? rings : board);
  vec3 dark = pattern == 5 ? tint : blue, light = pattern == 5 ? mix(tint, vec3(1.0), 0.7) : cream;
  return mix(plain, mix(light, dark, tile), shown);
}

// Normal (camera's frame) that faces the eye: of `n`, the smooth one, and `across`, that of the
// triangle, the signs have no meaning. `view` is the unit vector from the eye.
vec3 facing(vec3 n, vec3 across, vec3 view) {
  return normalize(dot(n, across) * dot(across, view) > 0.0 ? -n : n);
}

// Whether a pixel of a disc is not of the surface: beyond the rim, the border or the contour.
// `disc` is the place in the disc, its size, and how far it is beyond the border.
bool outside(vec4 disc, vec3 n, vec3 view) {
  return dot(disc.xy, disc.xy) > 1.0 || disc.w > 1.0 || (disc.z > 0.0 && dot(n, view) > -CONTOUR);
}

// How bright a surface is: a key light from above left, light from the sky, a little from the eye,
// darker towards the contour.
float brightness(vec3 n, vec3 view) {
  n = normalize(n - max(dot(n, view), 0.0) * view);
  float key = max(dot(n, normalize(vec3(-0.5, 0.65, 0.75))), 0.0), front = -dot(n, view);
  return (0.44 + 0.13 * n.y + 0.42 * key + 0.12 * front) * mix(0.8, 1.0, smoothstep(0.0, 0.4, front));
}
