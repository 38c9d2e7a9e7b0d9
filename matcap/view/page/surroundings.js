// A room without a picture: dim below, brighter above, a large soft lamp and a smaller one. The
// same sum of terms in GLSL, for mirroring, and here, for its irradiance. Grey, as the page is.

const ROOM_LAMPS = [
  // direction, sharpness, radiance
  { towards: unit([-0.55, 0.6, 0.6]), sharp: 14, power: 4.2 },
  { towards: unit([0.85, 0.05, 0.5]), sharp: 40, power: 3.0 },
];
const ROOM_BASE = 0.24, ROOM_RISE = 0.18;

export const ROOM_GLSL = `
vec3 roomRadiance(vec3 d) {
  float light = ${ROOM_BASE.toFixed(4)} + ${ROOM_RISE.toFixed(4)} * d.y;
${ROOM_LAMPS.map(lampLine).join("\n")}
  return vec3(light);
}`;

function lampLine({ towards, sharp, power }) {
  const place = towards.map((c) => c.toFixed(6)).join(", ");
  return `  light += ${power.toFixed(4)} * exp(${sharp.toFixed(4)} * (dot(d, vec3(${place})) - 1.0));`;
}

function unit(v) {
  const length = Math.hypot(...v);
  return v.map((c) => c / length);
}

export function roomRadiance(d) {
  let light = ROOM_BASE + ROOM_RISE * d[1];
  for (const { towards, sharp, power } of ROOM_LAMPS) {
    const cosine = d[0] * towards[0] + d[1] * towards[1] + d[2] * towards[2];
    light += power * Math.exp(sharp * (cosine - 1));
  }
  return light;
}

// Nine numbers a colour, such that the shader's polynomial in a normal is the irradiance
// (Ramamoorthi and Hanrahan 2001, eq. 11 to 13): 27 numbers in all.
export function roomHarmonics() {
  const basis = (x, y, z) => [
    0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
    0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y),
  ];
  const factors = [
    0.282095, 0.488603, 0.488603, 0.488603, 1.092548, 1.092548, 0.315392, 1.092548, 0.546274,
  ];
  const lobe = [Math.PI, ...Array(3).fill((2 * Math.PI) / 3), ...Array(5).fill(Math.PI / 4)];
  const sums = Array(9).fill(0);
  const rows = 64, columns = 128;
  for (let i = 0; i < rows; i++) {
    // Equal areas: bands of equal height.
    const z = 1 - (2 * (i + 0.5)) / rows, flat = Math.sqrt(1 - z * z);
    for (let j = 0; j < columns; j++) {
      const angle = (2 * Math.PI * (j + 0.5)) / columns;
      const d = [flat * Math.cos(angle), flat * Math.sin(angle), z];
      const light = roomRadiance(d);
      basis(...d).forEach((value, k) => { sums[k] += light * value; });
    }
  }
  const share = (4 * Math.PI) / (rows * columns);
  return new Float32Array(
    sums.flatMap((sum, k) => Array(3).fill(sum * share * lobe[k] * factors[k])),
  );
}
