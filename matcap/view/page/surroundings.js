// Rooms without a picture: dim below, brighter above, and soft lamps. The same sum of terms in GLSL,
// for mirroring and for what one sees behind a sphere, and here, for its irradiance.

const grey = (value) => [value, value, value];

export const ROOMS = {
  // A large soft lamp and a smaller one; grey, as the page is.
  studio: {
    base: grey(0.24), rise: grey(0.18),
    lamps: [
      { towards: unit([-0.55, 0.6, 0.6]), sharp: 14, power: grey(4.2) },
      { towards: unit([0.85, 0.05, 0.5]), sharp: 40, power: grey(3.0) },
    ],
  },
  // Four panes of daylight on the left, a warm floor.
  window: {
    base: [0.2, 0.19, 0.18], rise: [0.06, 0.07, 0.09],
    lamps: [[-0.95, 0.62], [-0.7, 0.62], [-0.95, 0.24], [-0.7, 0.24]].map(([x, y]) => (
      { towards: unit([x, y, 0.62]), sharp: 48, power: [3.6, 4.1, 4.8] })),
  },
  // A low sun behind haze, a blue sky.
  dusk: {
    base: [0.2, 0.21, 0.27], rise: [0.06, 0.12, 0.24],
    lamps: [
      { towards: unit([0.8, 0.16, 0.35]), sharp: 60, power: [11, 6, 2.4] },
      { towards: unit([0.8, 0.1, 0.35]), sharp: 9, power: [1.5, 0.75, 0.32] },
    ],
  },
};
const MOST_LAMPS = 4;

export const ROOM_GLSL = `
uniform vec3 roomBase, roomRise;
uniform vec4 lampTowards[${MOST_LAMPS}]; // and how sharp
uniform vec3 lampPower[${MOST_LAMPS}];

vec3 roomRadiance(vec3 d) {
  vec3 light = roomBase + roomRise * d.y;
  for (int i = 0; i < ${MOST_LAMPS}; i++) {
    light += lampPower[i] * exp(lampTowards[i].w * (dot(d, lampTowards[i].xyz) - 1.0));
  }
  return light;
}`;

// Tell the shader of a room.
export function setRoom(gl, places, { base, rise, lamps }) {
  const towards = new Float32Array(4 * MOST_LAMPS), power = new Float32Array(3 * MOST_LAMPS);
  lamps.forEach((lamp, index) => {
    towards.set([...lamp.towards, lamp.sharp], 4 * index);
    power.set(lamp.power, 3 * index);
  });
  gl.uniform3f(places.roomBase, ...base);
  gl.uniform3f(places.roomRise, ...rise);
  gl.uniform4fv(places.lampTowards, towards);
  gl.uniform3fv(places.lampPower, power);
  gl.uniform3fv(places.harmonics, roomHarmonics({ base, rise, lamps }));
}

function unit(v) {
  const length = Math.hypot(...v);
  return v.map((c) => c / length);
}

export function roomRadiance({ base, rise, lamps }, d) {
  const light = base.map((value, c) => value + rise[c] * d[1]);
  for (const { towards, sharp, power } of lamps) {
    const cosine = d[0] * towards[0] + d[1] * towards[1] + d[2] * towards[2];
    const share = Math.exp(sharp * (cosine - 1));
    power.forEach((value, c) => { light[c] += value * share; });
  }
  return light;
}

// Nine numbers a colour, such that the shader's polynomial in a normal is the irradiance
// (Ramamoorthi and Hanrahan 2001, eq. 11 to 13): 27 numbers in all.
function roomHarmonics(room) {
  const basis = (x, y, z) => [
    0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
    0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y),
  ];
  const factors = [
    0.282095, 0.488603, 0.488603, 0.488603, 1.092548, 1.092548, 0.315392, 1.092548, 0.546274,
  ];
  const lobe = [Math.PI, ...Array(3).fill((2 * Math.PI) / 3), ...Array(5).fill(Math.PI / 4)];
  const sums = new Float64Array(27);
  const rows = 64, columns = 128;
  for (let i = 0; i < rows; i++) {
    // Equal areas: bands of equal height.
    const z = 1 - (2 * (i + 0.5)) / rows, flat = Math.sqrt(1 - z * z);
    for (let j = 0; j < columns; j++) {
      const angle = (2 * Math.PI * (j + 0.5)) / columns;
      const d = [flat * Math.cos(angle), flat * Math.sin(angle), z];
      const light = roomRadiance(room, d);
      basis(...d).forEach((value, k) => {
        for (let c = 0; c < 3; c++) sums[3 * k + c] += light[c] * value;
      });
    }
  }
  const share = (4 * Math.PI) / (rows * columns);
  return Float32Array.from(sums, (sum, i) => sum * share * lobe[Math.floor(i / 3)]
    * factors[Math.floor(i / 3)]);
}
