// Adjustments of a material's maps, in the same text form as in matcap/brdf/adjust.py.

export const UNCHANGED = { relief: 1, roughness: 0, saturation: 1, brightness: 1, tint: "#ffffff" };
const RANGES = { relief: [0, 10], roughness: [-1, 1], saturation: [0, 4], brightness: [0, 8] };
const LUMINANCE = [0.2126, 0.7152, 0.0722];

export function adjustmentsText(adjust) {
  return Object.keys(UNCHANGED).filter((name) => adjust[name] !== UNCHANGED[name])
    .map((name) => `${name}=${adjust[name]}`).join(",");
}

// Parse the text; invalid parts are ignored.
export function parseAdjustments(text) {
  const found = { ...UNCHANGED };
  for (const part of (text || "").split(",")) {
    const [name, value] = part.split("=");
    if (name === "tint" && /^#[0-9a-f]{6}$/.test(value) && value !== "#000000") found.tint = value;
    if (!(name in RANGES)) continue;
    const [least, most] = RANGES[name], number = Number(value);
    if (number >= least && number <= most) found[name] = number;
  }
  return found;
}

// Linear light of an sRGB code value from 0 to 1 (IEC 61966-2-1).
export function linearOf(code) {
  return code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4;
}

// Matrix, column by column, that diffuse albedo is multiplied by.
function colourMatrix({ saturation, brightness, tint }) {
  const linear = [1, 3, 5].map((at) => linearOf(parseInt(tint.slice(at, at + 2), 16) / 255));
  const light = linear.reduce((sum, value, k) => sum + value * LUMINANCE[k], 0);
  return LUMINANCE.flatMap((share, from) => linear.map((value, to) =>
    brightness * (value / light) * (share + saturation * ((from === to) - share))));
}

// Set the uniforms of ADJUST_GLSL.
export function useAdjustments(gl, places, adjust) {
  gl.uniformMatrix3fv(places.colouring, false, colourMatrix(adjust));
  gl.uniform2f(places.reliefAndRough, adjust.relief, adjust.roughness);
  gl.uniform1f(places.saturation, adjust.saturation);
}

export const ADJUST_GLSL = `
uniform mat3 colouring;      // of diffuse albedo
uniform vec2 reliefAndRough; // factor, and what is added
uniform float saturation;    // of a coloured F0, which has no tint and no brightness

Texel adjusted(Texel t) {
  float relief = reliefAndRough.x;
  t.diffuse = clamp(colouring * t.diffuse, 0.0, 1.0);
  if (saturation != 1.0) {
    float grey = dot(t.f0, vec3(${LUMINANCE}));
    t.f0 = clamp(grey + saturation * (t.f0 - grey), 0.0, 1.0);
  }
  t.surface *= vec4(1.0, relief, relief, relief * relief);
  t.height *= relief;
  if (reliefAndRough.y != 0.0) {
    float rough = clamp(sqrt(sqrt(t.surface.x)) + reliefAndRough.y, 0.001, 1.0);
    t.surface.x = rough * rough * rough * rough;
  }
  return t;
}
`;
