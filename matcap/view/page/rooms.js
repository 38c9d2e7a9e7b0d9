// Built-in environments: dim below, brighter above, with soft lamps.

import { directionOf } from "./surroundings.js";

const grey = (value) => [value, value, value];

export const ROOMS = {
  // A large soft lamp and a smaller one, grey.
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
const ROOM_WIDTH = 512; // texels: the smallest lamp spans fourteen

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

// An environment as an equirectangular picture.
export function roomPicture(room) {
  const width = ROOM_WIDTH, height = ROOM_WIDTH / 2, data = new Float32Array(3 * width * height);
  for (let row = 0, at = 0; row < height; row++) {
    for (let column = 0; column < width; column++, at += 3) {
      data.set(roomRadiance(room, directionOf((column + 0.5) / width, (row + 0.5) / height)), at);
    }
  }
  return { width, height, data };
}
