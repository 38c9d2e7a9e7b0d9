// The maps inside a document for sending (enclosed.py), and all their smaller forms: what
// matcap/view/moments.py and afar.py make of a map set.

import { linearOf } from "./adjust.js";

const PLANES = 9; // diffuse 3, F0, alpha squared, slopes along x and y, sum of squares, height

async function bytesOf(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Five maps in half floats, the height in steps.
export async function unpackTile({ size: [width, height], low, span, data }) {
  const bytes = await bytesOf(data);
  const count = width * height, words = bytes.length / 2;
  const tile = new Float32Array(6 * count);
  for (let i = 0; i < words; i++) {
    const word = bytes[i] | (bytes[words + i] << 8);
    tile[i] = i < 5 * count ? fromHalf(word) : low + (word / 65535) * span;
  }
  return tile;
}

// Diffuse albedo in a JPEG, the other three in steps, each less the one before it.
export async function unpackPiece({ size: [width, height], diffuse, low, span, data }) {
  const bytes = await bytesOf(data), count = width * height;
  const tile = new Float32Array(6 * count), last = [0, 0, 0];
  for (let i = 0; i < count; i++) {
    last[0] = (last[0] + bytes[i]) & 255;
    last[1] = (last[1] + bytes[count + i]) & 255;
    last[2] = (last[2] + (bytes[2 * count + i] | (bytes[3 * count + i] << 8))) & 65535;
    for (let k = 0; k < 3; k++) {
      tile[(3 + k) * count + i] = low[k] + (last[k] / (k < 2 ? 255 : 65535)) * span[k];
    }
  }
  const picture = new Image();
  picture.src = diffuse;
  await picture.decode();
  const drawing = new OffscreenCanvas(width, height).getContext("2d");
  drawing.drawImage(picture, 0, 0);
  const codes = drawing.getImageData(0, 0, width, height).data;
  for (let i = 0; i < 3 * count; i++) {
    tile[i] = linearOf(codes[4 * (i % count) + Math.floor(i / count)] / 255);
  }
  return tile;
}

function fromHalf(word) {
  const sign = word & 0x8000 ? -1 : 1, exponent = (word >> 10) & 31, rest = word & 1023;
  if (exponent === 0) return sign * rest * 2 ** -24;
  return sign * (1 + rest / 1024) * 2 ** (exponent - 15);
}

const wrapped = (value, side) => ((value % side) + side) % side;
const clamped = (value, side) => Math.min(Math.max(value, 0), side - 1);

export class Pyramid {
  // Beyond its borders it repeats, or stays as it is there.
  constructor(tile, width, height, texelSize, repeats = true) {
    this.within = repeats ? wrapped : clamped;
    const count = width * height, plane = (index) => tile.subarray(index * count, (index + 1) * count);
    this.ends = { specular: endsOf(plane(3)), roughness: endsOf(plane(4)), height: endsOf(plane(5)) };
    this.levels = [{ width, height, data: momentsOf(tile, width, height, texelSize, this.within) }];
  }

  // A level's rectangle.
  read(level, x, y, wide, tall) {
    while (this.levels.length <= level) this.levels.push(halved(this.levels.at(-1)));
    const { width, height, data } = this.levels[level];
    const albedo = new Float32Array(4 * wide * tall), surface = new Float32Array(4 * wide * tall);
    const relief = new Float32Array(wide * tall);
    for (let row = 0, i = 0; row < tall; row++) {
      const line = this.within(y + row, height) * width;
      for (let along = 0; along < wide; along++, i++) {
        const from = PLANES * (line + this.within(x + along, width)), to = 4 * i;
        for (let c = 0; c < 4; c++) albedo[to + c] = data[from + c];
        const sx = data[from + 5], sy = data[from + 6];
        surface[to] = data[from + 4];
        surface[to + 1] = sx;
        surface[to + 2] = sy;
        surface[to + 3] = Math.max(data[from + 7] - sx * sx - sy * sy, 0);
        relief[i] = data[from + 8];
      }
    }
    return { width: wide, height: tall, albedo, surface, relief };
  }
}

function momentsOf(tile, width, height, texelSize, within) {
  const count = width * height, heights = tile.subarray(5 * count), step = 0.5 / texelSize;
  const moments = new Float32Array(PLANES * count);
  for (let y = 0, i = 0; y < height; y++) {
    const up = within(y - 1, height) * width, down = within(y + 1, height) * width;
    for (let x = 0; x < width; x++, i++) {
      const left = y * width + within(x - 1, width), right = y * width + within(x + 1, width);
      const at = PLANES * i;
      for (let c = 0; c < 4; c++) moments[at + c] = tile[c * count + i];
      const sx = (heights[right] - heights[left]) * step;
      const sy = (heights[up + x] - heights[down + x]) * step;
      moments[at + 4] = Math.max(tile[4 * count + i], 1e-3) ** 4;
      moments[at + 5] = sx;
      moments[at + 6] = sy;
      moments[at + 7] = sx * sx + sy * sy;
      moments[at + 8] = heights[i];
    }
  }
  return moments;
}

// Means of four; an odd side is two of itself, which are even.
function halved({ width, height, data }) {
  const wide = width % 2 ? width : width / 2, tall = height % 2 ? height : height / 2;
  const half = new Float32Array(PLANES * wide * tall);
  for (let y = 0; y < tall; y++) {
    for (let x = 0; x < wide; x++) {
      const columns = [(2 * x) % width, (2 * x + 1) % width];
      const to = PLANES * (y * wide + x);
      for (const row of [(2 * y) % height, (2 * y + 1) % height]) {
        for (const column of columns) {
          const from = PLANES * (row * width + column);
          for (let c = 0; c < PLANES; c++) half[to + c] += 0.25 * data[from + c];
        }
      }
    }
  }
  return { width: wide, height: tall, data: half };
}

function endsOf(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}
