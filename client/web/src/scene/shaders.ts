// SPDX-License-Identifier: MIT
// GLSL of the stage: the surface, the background and the tone curve, as libprt/raster computes
// them (METHODS §6, §7).

export const tone = /* glsl */ `
uniform float exposure;  // 2^EV
uniform int curve;       // Tone of relight.proto; 3: linear radiance as it is, for tests
vec3 filmic(vec3 x) { return x * (x + 0.06) / (x * (x + 0.62) + 0.09); }
vec3 encoded(vec3 radiance) {
  if (curve == 3) return radiance;
  vec3 x = max(radiance * exposure, vec3(0.0));
  x = curve == 0 ? filmic(x) : curve == 1 ? x / (1.0 + x) : x;
  x = clamp(x, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(vec3(0.0031308), x));
}`;

// Bilinear look-up in a bordered cube of n x n texels whose faces are layers from \`first\` on.
export const cube = /* glsl */ `
vec3 fromCube(sampler2DArray faces, vec3 d, float n, float first) {
  vec3 a = abs(d);
  float face; vec2 st; float major;
  if (a.x >= a.y && a.x >= a.z) {
    face = d.x < 0.0 ? 1.0 : 0.0; major = a.x; st = vec2(d.x < 0.0 ? d.z : -d.z, -d.y);
  } else if (a.y >= a.z) {
    face = d.y < 0.0 ? 3.0 : 2.0; major = a.y; st = vec2(d.x, d.y < 0.0 ? -d.z : d.z);
  } else {
    face = d.z < 0.0 ? 5.0 : 4.0; major = a.z; st = vec2(d.z < 0.0 ? -d.x : d.x, -d.y);
  }
  vec2 at = ((st / max(major, 1e-30) * 0.5 + 0.5) * n + 1.0) / (n + 2.0);
  return texture(faces, vec3(at, first + face)).rgb;
}`;

// Real spherical harmonics up to l = 3, in the order of PROTOCOL.md (FACTORS).
export const harmonics = /* glsl */ `
void harmonics(vec3 d, out float y[16]) {
  float x = d.x, v = d.y, z = d.z;
  y[0] = 0.28209479;
  y[1] = 0.48860251 * v; y[2] = 0.48860251 * z; y[3] = 0.48860251 * x;
  y[4] = 1.09254843 * x * v; y[5] = 1.09254843 * v * z;
  y[6] = 0.31539157 * (3.0 * z * z - 1.0);
  y[7] = 1.09254843 * x * z; y[8] = 0.54627422 * (x * x - v * v);
  y[9] = 0.59004359 * v * (3.0 * x * x - v * v); y[10] = 2.89061144 * x * v * z;
  y[11] = 0.45704580 * v * (5.0 * z * z - 1.0); y[12] = 0.37317633 * z * (5.0 * z * z - 3.0);
  y[13] = 0.45704580 * x * (5.0 * z * z - 1.0); y[14] = 1.44530572 * z * (x * x - v * v);
  y[15] = 0.59004359 * x * (x * x - 3.0 * v * v);
}`;

const inwards = /* glsl */ `
// The direction inside whose refraction is w; c: cosine of w to the normal m.
vec3 inwards(vec3 w, vec3 m, float c) {
  return w / eta + (sqrt(1.0 - (1.0 - c * c) / (eta * eta)) - c / eta) * m;
}`;

// The vertex's parts (PROTOCOL, COLORS): layer 0 is M, layer 1 + k is S_k, N_EXIT planes of exit
// follow. N_SINGLE layers of single scattering; N_PIXEL of them, from S_1 on, are evaluated for
// the direction of the pixel. Those for which there are no varyings, and the planes of exit,
// which vary little from vertex to vertex, are evaluated for that of the vertex.
const colorInput = /* glsl */ `
uniform highp sampler2DArray vertexColors;
out vec3 multiple;
out vec3 single;
#if N_PIXEL > 0
out vec3 phase[N_PIXEL];
#endif
#ifdef SEAMS
in uint source; // vertices at seams are several: the one of the file
#define VERTEX int(source)
#else
#define VERTEX gl_VertexID
#endif
vec3 part(int layer) {
  return texelFetch(vertexColors, ivec3(VERTEX % VERTEX_WIDTH, VERTEX / VERTEX_WIDTH, layer), 0).rgb;
}
void readColors() {
  multiple = part(0);
  single = vec3(0.0);
#if N_SINGLE > 0
  single = part(1);
#endif
#if N_PIXEL > 0
  for (int k = 1; k <= N_PIXEL; k++) phase[k - 1] = part(1 + k);
#endif
#if N_SINGLE > 1 + N_PIXEL || N_EXIT > 0
  vec3 w = normalize(eye - position);
  float y[16];
  harmonics(inwards(w, normal, clamp(dot(w, normal), 0.0, 1.0)), y);
  for (int k = 1 + N_PIXEL; k < N_SINGLE; k++) single += y[k] * part(1 + k);
  for (int k = 0; k < N_EXIT; k++) multiple += (k > 0 ? y[k] : 1.0) * part(1 + N_SINGLE + k);
#endif
}`;

export const VERTEX_WIDTH = 256;

// The sky that the model hides from a vertex, as spherical harmonics up to l = 3: the share of a
// reflection from direction d that is not hidden (PROTOCOL, GEOMETRY). Of meshes of many vertices it
// is found at the vertices (BLOCKED 2), whose reflections differ little from those of the pixels.
const openShare = /* glsl */ `
float openShare(vec3 d, vec4 hidden0, vec4 hidden1, vec4 hidden2, vec4 hidden3) {
  float y[16];
  harmonics(d, y);
  float sum = dot(hidden0, vec4(y[0], y[1], y[2], y[3])) + dot(hidden1, vec4(y[4], y[5], y[6], y[7])) +
    dot(hidden2, vec4(y[8], y[9], y[10], y[11])) + dot(hidden3, vec4(y[12], y[13], y[14], y[15]));
  return clamp(3.0 * (1.0 - sum * (4.0 / 127.0)) - 0.7, 0.0, 1.0);
}`;
const blockedInput = /* glsl */ `
#ifdef BLOCKED
in vec4 blocked0, blocked1, blocked2, blocked3;
#if BLOCKED == 2
out float open;
${openShare}
void readBlocked() {
  vec3 w = normalize(eye - position);
  open = openShare(2.0 * dot(w, normal) * normal - w, blocked0, blocked1, blocked2, blocked3);
}
#else
out vec4 hidden0, hidden1, hidden2, hidden3;
void readBlocked() {
  hidden0 = blocked0; hidden1 = blocked1; hidden2 = blocked2; hidden3 = blocked3;
}
#endif
#else
void readBlocked() {}
#endif`;
const unblocked = /* glsl */ `
#ifndef BLOCKED
float unblocked(vec3 d) { return 1.0; }
#elif BLOCKED == 2
in float open;
float unblocked(vec3 d) { return open; }
#else
in vec4 hidden0, hidden1, hidden2, hidden3;
${openShare}
float unblocked(vec3 d) { return openShare(d, hidden0, hidden1, hidden2, hidden3); }
#endif`;

/** The vertex shader of a surface whose maps take these sets of texture coordinates. */
export const surfaceVertex = (uvSets: readonly number[]) => /* glsl */ `
precision highp float;
precision highp int;
uniform mat4 modelViewMatrix, projectionMatrix;
uniform vec3 eye;
uniform float eta;
in vec3 position;
in vec3 normal;
${uvSets.map((set) => `in vec2 uv${set};`).join("\n")}
#ifdef TINTED
in vec4 tint;
out vec4 vertexTint;
#endif
out vec3 at;
out vec3 n;
#if N_UV > 0
out vec2 coordinates[N_UV];
#endif
#ifndef STILL
${harmonics}
${inwards}
${colorInput}
#elif defined(BLOCKED) && BLOCKED == 2
${harmonics}
#endif
${blockedInput}
#ifdef STILL
invariant gl_Position;
#endif
void main() {
  readBlocked();
  at = position;
  n = normal;
  ${uvSets.map((set, i) => `coordinates[${i}] = uv${set};`).join("\n  ")}
#ifdef TINTED
  vertexTint = tint;
#endif
#ifndef STILL
  readColors();
#endif
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

// The look of a textured surface at the pixel, as libprt/mesh has it (METHODS §10).
const look = /* glsl */ `
uniform vec4 baseColor;
uniform vec3 emissive;
uniform float roughnessFactor;
uniform float split;          // share of the base colour that the bake has blurred
uniform bool plainLook;       // no maps: irradiance
#ifdef TINTED
in vec4 vertexTint;
#endif
#if N_UV > 0
in vec2 coordinates[N_UV];
vec2 placed(vec3 place[2], vec2 uv) {
  return vec2(dot(place[0], vec3(uv, 1.0)), dot(place[1], vec3(uv, 1.0)));
}
#endif
#ifdef BASE_UV
uniform sampler2D baseMap;
uniform vec3 basePlace[2];
#endif
#ifdef NORMAL_UV
uniform sampler2D normalMap;
uniform vec3 normalPlace[2];
uniform float normalScale;
#endif
#ifdef ROUGHNESS_UV
uniform sampler2D roughnessMap;
uniform vec3 roughnessPlace[2];
#endif
#ifdef OCCLUSION_UV
uniform sampler2D occlusionMap;
uniform vec3 occlusionPlace[2];
uniform float occlusionScale;
#endif
#ifdef EMISSIVE_UV
uniform sampler2D emissiveMap;
uniform vec3 emissivePlace[2];
#endif
struct Look { vec3 base, normal, emission; float roughness, occlusion, variance; };

// Directions in which u and v of the normal map grow, from the steps of position and
// coordinates between pixels, which lie on the triangle's plane.
#ifdef NORMAL_UV
void turn(inout Look look, vec3 at) {
  vec2 st = placed(normalPlace, coordinates[NORMAL_UV]);
  vec3 m = 2.0 * texture(normalMap, st).xyz - 1.0, n = look.normal;
  vec3 e0 = dFdx(at), e1 = dFdy(at);
  vec2 s0 = dFdx(st), s1 = dFdy(st);
  float det = s0.x * s1.y - s0.y * s1.x;
  if (det == 0.0) return;
  float side = sign(det);
  vec3 t = side * (s1.y * e0 - s0.y * e1), v = side * (s0.x * e1 - s1.x * e0);
  t -= dot(t, n) * n;
  if (dot(t, t) == 0.0) return;
  t = normalize(t);
  vec3 b = cross(n, t);
  b *= dot(b, v) < 0.0 ? 1.0 : -1.0; // glTF's green points up the image, against v
  look.variance = max(1.0 - length(m), 0.0);
  look.normal = normalize(normalScale * (m.x * t + m.y * b) + max(m.z, 1e-3) * n);
}
#endif

Look lookAt(vec3 at, vec3 n, float opaque, float mediumRoughness) {
  Look look = Look(vec3(1.0), n, emissive, mediumRoughness, 1.0, 0.0);
  vec4 base = baseColor;
#ifdef BASE_UV
  base *= texture(baseMap, placed(basePlace, coordinates[BASE_UV]));
#endif
#ifdef TINTED
  base *= clamp(vertexTint, 0.0, 1.0);
#endif
  float luminance = max(dot(base.rgb, vec3(0.2126, 0.7152, 0.0722)), 0.02);
  look.base = opaque > 0.5 || split <= 0.0 ? base.rgb : base.rgb / pow(luminance, split);
#ifdef NORMAL_UV
  turn(look, at);
#endif
#ifdef ROUGHNESS_UV
  look.roughness = max(roughnessFactor * texture(roughnessMap, placed(roughnessPlace, coordinates[ROUGHNESS_UV])).g, 1e-3);
#endif
#ifdef OCCLUSION_UV
  float open = texture(occlusionMap, placed(occlusionPlace, coordinates[OCCLUSION_UV])).r;
  look.occlusion = clamp(1.0 + occlusionScale * (open - 1.0), 1e-3, 1.0);
#endif
#ifdef EMISSIVE_UV
  look.emission *= texture(emissiveMap, placed(emissivePlace, coordinates[EMISSIVE_UV])).rgb;
#endif
  if (plainLook) return Look(vec3(1.0), n, vec3(0.0), mediumRoughness, 1.0, 0.0);
  return look;
}`;

// The light that a surface reflects, filtered to its roughness.
export const reflection = /* glsl */ `
uniform sampler2DArray lobes; // [6 levels][6 faces]
uniform mat3 lobeTurn;        // world to the lobes' light
uniform vec3 lobeGain;
vec3 reflected(vec3 d, float rough) {
  float k = rough <= 0.15 ? 0.0 : rough <= 0.3 ? 1.0 : rough <= 0.45 ? 2.0 : rough <= 0.65 ? 3.0 : 4.0;
  float lo = k == 0.0 ? 0.0 : k == 1.0 ? 0.15 : k == 2.0 ? 0.3 : k == 3.0 ? 0.45 : 0.65;
  float wide = k <= 2.0 ? 0.15 : k == 3.0 ? 0.2 : 0.35;
  float share = clamp((rough - lo) / wide, 0.0, 1.0);
  vec3 to = lobeTurn * d;
  return lobeGain *
    mix(fromCube(lobes, to, 32.0, 6.0 * k), fromCube(lobes, to, 32.0, 6.0 * k + 6.0), share);
}`;

export const surfaceFragment = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2DArray;
uniform vec3 eye;
uniform float eta, roughness;
uniform float transmission;   // 1: F_t of the view over \`divisor\`; 0: none (a term by itself)
uniform float divisor;        // the factor that the colours already have
uniform float viewSlope;      // of single scattering towards an eye (PROTOCOL, FACTORS)
uniform float reflection;     // 1: reflections are added
uniform float opaque;
in vec3 at, n;
#ifdef STILL
// What does not depend on the light (still-surface.ts).
layout(location = 0) out vec4 still0;
layout(location = 1) out vec4 still1;
layout(location = 2) out vec4 still2;
layout(location = 3) out vec4 still3;
#else
in vec3 multiple, single;
#if N_PIXEL > 0
in vec3 phase[N_PIXEL];
#endif
out vec4 color;
${tone}
${cube}
${reflection}
#endif
${harmonics}
${inwards}
${unblocked}
${look}
// A normal that turns away from the eye is bent towards it; c: its cosine to w.
vec3 facingEye(vec3 m, vec3 w, float least, out float c) {
  float own = min(dot(w, m), 1.0);
  c = max(own, least);
  if (own > least) return m;
  float keep = sqrt((1.0 - c * c) / (1.0 - own * own + 1e-12));
  return keep * m + (c - keep * own) * w;
}
float mirrorShare(float c) {
  float ct = sqrt(1.0 - (1.0 - c * c) / (eta * eta));
  float rs = (c - eta * ct) / (c + eta * ct), rp = (eta * c - ct) / (eta * c + ct);
  return 0.5 * (rs * rs + rp * rp);
}
void main() {
  vec3 w = normalize(eye - at), own = normalize(n);
  // The variance of normals over the pixel widens the lobe.
  float variance = (dot(dFdx(own), dFdx(own)) + dot(dFdy(own), dFdy(own))) / 24.0;
  Look look = lookAt(at, own, opaque, roughness);
  variance = 1.0 - (1.0 - variance) * (1.0 - look.variance);
  float facing = abs(dot(normalize(cross(dFdx(at), dFdy(at))), w));
  float least = max(0.5 * facing, 1e-3), c, cm;
  vec3 m = facingEye(own, w, least, c);
  float t = opaque > 0.5 || transmission < 0.5 ? 1.0 : (1.0 - mirrorShare(c)) / divisor;
  vec3 inside = inwards(w, m, c);
  // The slope belongs to the vertices' normals.
  float slope = 1.0 + viewSlope * (1.0 - dot(n, inside));
  vec3 through = t * look.base * (opaque > 0.5 ? look.occlusion : 1.0);
  float spread = min(2.0 * variance, 0.18);
  float rough = spread > 1e-4 ? sqrt(sqrt(pow(look.roughness, 4.0) + spread)) : look.roughness;
  vec3 turned = facingEye(look.normal, w, least, cm), from = 2.0 * cm * turned - w;
  float mirror = 0.0;
  if (reflection > 0.5 && opaque < 0.5)
    mirror = mirrorShare(cm) * unblocked(from) * look.occlusion;
#ifdef STILL
  still0 = vec4(through, slope);
  still1 = vec4(from, mirror);
  still2 = vec4(min(look.emission, vec3(65504.0)), rough);
  still3 = vec4(inside, 0.0);
#else
  vec3 scattered = single;
#if N_PIXEL > 0
  float y[16];
  harmonics(inside, y);
  for (int k = 1; k <= N_PIXEL; k++) scattered += y[k] * phase[k - 1];
#endif
  vec3 body = max(through * (multiple + slope * scattered), vec3(0.0)) + look.emission;
  if (mirror > 0.0) body += mirror * reflected(from, rough);
  color = vec4(encoded(body), 1.0);
#endif
}`;

/** With PLAIN the background has one colour, which the vertex shader encodes. It is a define and no
 * branch: a software GPU computes both sides of a branch. */
export const backgroundVertex = /* glsl */ `
precision highp float;
precision highp int;
in vec3 position;
uniform vec3 plain;
uniform mat4 unproject; // from clip space to world directions
out vec3 direction;
#ifdef PLAIN
${tone}
#endif
void main() {
#ifdef PLAIN
  direction = encoded(plain);
#else
  direction = (unproject * vec4(position.xy, 1.0, 1.0)).xyz;
#endif
  gl_Position = vec4(position.xy, 1.0, 1.0);
}`;

export const backgroundFragment = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2DArray;
in vec3 direction;
out vec4 color;
#ifdef PLAIN
void main() { color = vec4(direction, 1.0); }
#else
uniform sampler2DArray sky;
uniform float side;
uniform mat3 turn;      // world to environment
uniform vec3 gain;
${tone}
${cube}
void main() { color = vec4(encoded(gain * fromCube(sky, turn * direction, side, 0.0)), 1.0); }
#endif`;

/** One texel a vertex: Σ_r U[v][r] b[r] (PROTOCOL, FACTORS). */
export const factorVertex = /* glsl */ `
precision highp float;
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;

export const factorFragment = /* glsl */ `
precision highp float;
precision highp int;
uniform highp isampler2D factors;     // pairs of columns, FACTOR_WIDTH texels a row
uniform highp usampler2D places;      // of a vertex: first texel, stride, rank, first row
uniform highp sampler2D rows;         // coefficients, ROW_WIDTH a row
uniform float scale;
out vec4 color;
void main() {
  uvec4 p = texelFetch(places, ivec2(gl_FragCoord.xy), 0);
  vec3 sum = vec3(0.0);
  for (uint r = 0u; r < p.z; r += 2u) {
    uint u = p.x + (r >> 1u) * p.y, row = p.w + r;
    vec2 k = vec2(texelFetch(factors, ivec2(u % FACTOR_WIDTH, u / FACTOR_WIDTH), 0).xy);
    sum += k.x * texelFetch(rows, ivec2(row % ROW_WIDTH, row / ROW_WIDTH), 0).rgb;
    if (r + 1u < p.z) {
      row++;
      sum += k.y * texelFetch(rows, ivec2(row % ROW_WIDTH, row / ROW_WIDTH), 0).rgb;
    }
  }
  color = vec4(sum * scale, 1.0);
}`;
export const FACTOR_WIDTH = 4096;
export const ROW_WIDTH = 1024;
