// The page's shader. Units: half the picture's long side for a plane, the radius for a sphere or
// cylinder. The reflectance is that of matcap/relight/loops/loops.h; the camera is that of the
// photograph, 45 degrees across the long side, straight above.

import { CELLS } from "./pages.js";
import { SURROUNDINGS_GLSL } from "./surroundings.js";

const VERTEX = `#version 300 es
void main() {
  // One triangle that covers the picture.
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2D;
precision highp sampler2DArray;
uniform sampler2DArray albedo;   // diffuse, F0
uniform sampler2DArray surface;  // alpha squared, slopes along x and y, their variance
uniform sampler2DArray relief;   // height
uniform sampler2DArray metal;    // F0 of green and blue, where it has a colour
uniform sampler2D table;      // two texels a cell: its page's layer, place and scale; its level and colour
uniform vec2 size;            // of the picture, pixels
uniform vec2 corner;          // its left bottom one
uniform vec4 middle;          // where the picture's middle lies in its cell, texels; which cell
uniform float texels;         // texels to a unit
uniform float tableScale;     // texels of the table's level to one of the finest
uniform vec4 bounds;          // texels from the middle beyond which there is nothing
uniform vec3 meanDiffuse, meanF0;      // where there is nothing yet
uniform vec4 meanSurface;
uniform int shape;            // 0 plane, 1 sphere, 2 cylinder
uniform int map;              // 0 lit, then diffuse, specular, roughness, height, normal
uniform bool room;            // surroundings, not the point light
uniform vec3 lightPlace;
uniform float intensity;
uniform bool photographed;    // the photograph itself
uniform sampler2D photograph; // as large as the bounds
uniform float gain;
uniform vec2 range;           // of the map shown, black to white
uniform int mirrored;         // directions of the room that each pixel looks in
uniform mat3 turned;          // scene to room
uniform vec3 ground;          // where there is nothing: a colour as it is shown
out vec4 colour;

const float PI = 3.14159265358979;
const float REACH = 0.41421356237;  // tan(22.5 degrees)
const float GRAZING = 0.02; // least cosine of a normal that is seen
const float BLUR = 0.25; // of a direction's solid angle, as in relight/effects/environment.py

TABLE

SURROUNDINGS

struct Texel { vec3 diffuse; vec3 f0; vec4 surface; float height; };

// Texture coordinates, within a table entry's page, of a position in a cell, in texels.
Texel read(vec4 entry, vec2 along, float mip, bool coloured) {
  if (entry.x < 0.0) return Texel(meanDiffuse, meanF0, meanSurface, 0.0);
  vec3 at = vec3((APRON + entry.yz * PAGE + along * entry.w) / (PAGE + 2.0 * APRON), entry.x);
  vec4 a = textureLod(albedo, at, mip);
  vec3 f0 = coloured ? vec3(a.a, textureLod(metal, at, mip).rg) : vec3(a.a);
  return Texel(a.rgb, f0, textureLod(surface, at, mip),
    map == 4 ? textureLod(relief, at, mip).r : 0.0);
}

Texel readAt(vec2 fromMiddle, float level) {
  // Rounded, so that a texel's centre reads that texel alone.
  vec2 place = floor((middle.xy + fromMiddle * tableScale) * 1024.0 + 0.5) / 1024.0;
  vec2 cell = floor(place / PAGE), along = place - cell * PAGE;
  ivec2 at = ivec2(mod(middle.zw + cell, CELLS)) * ivec2(2, 1);
  vec4 more = texelFetch(table, at + ivec2(1, 0), 0);
  return read(texelFetch(table, at, 0), along, level - more.x, more.y > 0.5);
}

vec3 encode(vec3 light) {
  vec3 c = clamp(light, 0.0, 1.0);
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

vec3 stretched(vec3 value) {
  return (value - range.x) / (range.y - range.x);
}

// D G / (4 (n.l)(n.v)) in x, l.h in y.
vec2 ggxSmith(vec3 n, vec3 v, vec3 l, float nv, float nl, float a2) {
  vec3 h = l + v;
  float hh = max(dot(h, h), 1e-20);
  vec3 sine = cross(n, h);
  float c = nl + nv;
  float d = sqrt(a2) * hh / (dot(sine, sine) + c * c * a2);
  float rest = 1.0 - a2;
  float smith = nl * sqrt(nv * nv * rest + a2) + nv * sqrt(nl * nl * rest + a2);
  return vec2(d * d * 0.5 / PI / max(smith, 1e-7), sqrt(hh) * 0.5);
}

float schlickWeight(float lh) {
  float rest = max(1.0 - lh, 0.0);
  return rest * rest * rest * rest * rest;
}

// Sample a half vector from the distribution of visible normals [heitz2018].
vec3 visibleNormal(vec3 v, float alpha, vec2 at) {
  vec3 stretched = normalize(vec3(alpha * v.xy, v.z));
  float flat2 = dot(stretched.xy, stretched.xy);
  vec3 t1 = flat2 > 1e-12 ? vec3(-stretched.y, stretched.x, 0.0) / sqrt(flat2) : vec3(1, 0, 0);
  vec3 t2 = cross(stretched, t1);
  float r = sqrt(at.x), phi = 2.0 * PI * at.y;
  float p1 = r * cos(phi), s = 0.5 * (1.0 + stretched.z);
  float p2 = mix(sqrt(max(1.0 - p1 * p1, 0.0)), r * sin(phi), s);
  vec3 n = p1 * t1 + p2 * t2 + sqrt(max(1.0 - p1 * p1 - p2 * p2, 0.0)) * stretched;
  return normalize(vec3(alpha * n.xy, max(n.z, 1e-6)));
}

vec3 roomSpecular(vec3 n, vec3 v, mat3 frame, vec3 f0, float a2, float nv) {
  // Tangent frame of the shading normal.
  vec3 t = normalize(abs(n.x) < 0.9 ? cross(n, vec3(1, 0, 0)) : cross(n, vec3(0, 1, 0)));
  mat3 around = mat3(t, cross(n, t), n);
  vec3 seen = v * around;
  float alpha = sqrt(a2);
  vec3 total = vec3(0.0);
  for (int i = 0; i < mirrored; i++) {
    float radical = float(bitfieldReverseOf(uint(i))) * 2.3283064365386963e-10;
    vec3 h = visibleNormal(seen, alpha, vec2((float(i) + 0.5) / float(mirrored), radical));
    float spread = dot(h.xy, h.xy) + a2 * h.z * h.z;
    vec3 l = reflect(-seen, h);
    vec3 direction = around * l;
    if (l.z <= 0.0 || direction.z <= 0.0) continue;
    // Weight F G2 / G1 with the height-correlated Smith G2.
    float lv = sqrt(a2 + (1.0 - a2) * seen.z * seen.z) / max(seen.z, 1e-6);
    float ll = sqrt(a2 + (1.0 - a2) * l.z * l.z) / l.z;
    float weight = (1.0 + lv) / (lv + ll);
    vec3 fresnel = f0 + (1.0 - f0) * schlickWeight(dot(l, h));
    // Solid angle of the sample [krivanek2008], with a smaller blur.
    float density = a2 / (PI * spread * spread) / (2.0 * max(seen.z, 1e-6) * (1.0 + lv));
    float solid = BLUR / (float(mirrored) * max(density, 1e-9));
    total += radianceFrom(turned * (frame * direction), solid) * (weight * fresnel);
  }
  return total / float(mirrored);
}

void main() {
  float half_ = max(size.x, size.y) * 0.5;
  vec2 s = (gl_FragCoord.xy - corner - 0.5 * size) / half_;
  float away = 1.0 / REACH;
  vec3 point, eye;
  mat3 frame = mat3(1.0);
  vec2 place;
  float footprint;
  if (shape == 0) {
    eye = vec3(0.0, 0.0, away);
    point = vec3(s, 0.0);
    place = s;
    footprint = 1.0 / half_;
  } else {
    float sides = max(size.x, size.y) / min(size.x, size.y);
    eye = vec3(0.0, 0.0, (shape == 1 ? 1.25 : 1.6) * sides * away);
    vec3 direction = normalize(vec3(s * REACH, -1.0));
    bool upright = shape == 2;
    vec3 flat_ = upright ? vec3(1, 0, 1) : vec3(1);
    vec3 o = eye * flat_, d = direction * flat_;
    float a = dot(d, d), b = dot(o, d), c = dot(o, o) - 1.0;
    float inside = b * b - a * c;
    float along = inside > 0.0 ? (-b - sqrt(inside)) / a : -1.0;
    point = eye + along * direction;
    if (along <= 0.0 || (upright && abs(point.y) > 1.0)) {
      vec3 behind = encode(radianceFrom(turned * direction, 0.0) * gain);
      colour = vec4(room ? behind : ground, 1.0);
      return;
    }
    float longitude = atan(point.x, point.z);
    vec3 tangent = vec3(cos(longitude), 0.0, -sin(longitude));
    vec3 normal = upright ? vec3(-tangent.z, 0.0, tangent.x) : normalize(point);
    frame = mat3(tangent, cross(normal, tangent), normal);
    place = vec2(longitude, upright ? point.y : asin(clamp(normal.y, -1.0, 1.0)));
    float facing = dot(-direction, normal);
    footprint = along * REACH / half_ / max(facing, 1e-3);
  }
  vec2 fromMiddle = vec2(place.x, -place.y) * texels;
  if (any(lessThan(fromMiddle, bounds.xy)) || any(greaterThan(fromMiddle, bounds.zw))) {
    colour = vec4(ground, 1.0);
    return;
  }
  if (photographed) {
    vec2 at = (fromMiddle - bounds.xy) / (bounds.zw - bounds.xy);
    vec2 pixels = vec2(textureSize(photograph, 0)) / (bounds.zw - bounds.xy);
    float smaller = log2(max(footprint * texels * pixels.x, 1.0));
    colour = vec4(encode(textureLod(photograph, at, smaller).rgb * gain), 1.0);
    return;
  }
  float level = log2(max(footprint * texels, 1.0));
  Texel texel = readAt(fromMiddle, level);
  vec4 b = texel.surface;
  float a2 = min(b.x + b.w, 1.0);
  vec3 n = normalize(vec3(-b.yz, 1.0));
  vec3 shown;
  if (map == 1) shown = encode(texel.diffuse);
  else if (map == 2) shown = stretched(texel.f0);
  else if (map == 3) shown = stretched(vec3(sqrt(sqrt(b.x))));
  else if (map == 4) shown = stretched(vec3(texel.height));
  else if (map == 5) shown = 0.5 + 0.5 * n;
  else {
    vec3 v = normalize(eye - point) * frame;
    // A normal that faces away would be a black pixel at the outline under an environment; it is
    // rotated towards the viewer just enough.
    if (room) n = normalize(n + v * max(GRAZING - dot(n, v), 0.0));
    float nv = max(dot(n, v), 0.0);
    vec3 radiance = vec3(0.0);
    if (nv > 0.0 && v.z > 0.0) {
      if (room) {
        // A tilted normal receives light only from above the surface.
        vec3 lambert = texel.diffuse / PI * irradianceOn(turned * (frame * n)) * (0.5 + 0.5 * n.z);
        radiance = lambert + roomSpecular(n, v, frame, texel.f0, a2, nv);
      } else {
        vec3 offset = lightPlace - point;
        float squared = dot(offset, offset);
        vec3 l = (offset * inversesqrt(squared)) * frame;
        float nl = max(dot(n, l), 0.0);
        if (nl > 0.0 && l.z > 0.0) {
          vec2 lobe = ggxSmith(n, v, l, nv, nl, a2);
          vec3 fresnel = texel.f0 + (1.0 - texel.f0) * schlickWeight(lobe.y);
          radiance = (texel.diffuse / PI + fresnel * lobe.x) * intensity * (nl / squared);
        }
      }
    }
    shown = encode(radiance * gain);
  }
  colour = vec4(clamp(shown, 0.0, 1.0), 1.0);
}`;

// Texture unit of each sampler: two types at one unit are an error, even if unused. The last unit
// is for uploads, which must not change the bindings for drawing.
const UNITS = ["albedo", "surface", "relief", "metal", "table", "radiances", "irradiances", "photograph"];
export const UNIT = Object.fromEntries([...UNITS, "spare"].map((name, unit) => [name, unit]));

// Compile and link; throws an error with the driver's message.
export function buildProgram(gl, { width, height, apron }) {
  const source = FRAGMENT.replace("SURROUNDINGS", SURROUNDINGS_GLSL + BITS_GLSL)
    .replace("TABLE", `
const float CELLS = ${CELLS}.0;
const vec2 PAGE = vec2(${width}.0, ${height}.0);
const float APRON = ${apron}.0;`);
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, source]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(gl.getShaderInfoLog(shader) || "a shader does not compile");
    }
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(gl.getProgramInfoLog(program) || "the shader does not link");
  }
  const places = {};
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  for (let i = 0; i < count; i++) {
    const { name } = gl.getActiveUniform(program, i);
    places[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
  }
  gl.useProgram(program);
  gl.bindVertexArray(gl.createVertexArray());
  for (const name of UNITS) gl.uniform1i(places[name], UNIT[name]);
  gl.activeTexture(gl.TEXTURE0 + UNIT.spare);
  return places;
}

// GLSL ES 3.00 has no bitfieldReverse.
const BITS_GLSL = `
uint bitfieldReverseOf(uint x) {
  x = (x << 16u) | (x >> 16u);
  x = ((x & 0x00ff00ffu) << 8u) | ((x & 0xff00ff00u) >> 8u);
  x = ((x & 0x0f0f0f0fu) << 4u) | ((x & 0xf0f0f0f0u) >> 4u);
  x = ((x & 0x33333333u) << 2u) | ((x & 0xccccccccu) >> 2u);
  return ((x & 0x55555555u) << 1u) | ((x & 0xaaaaaaaau) >> 1u);
}`;
