// Unpacks the maps inside a self-contained document (document.py), and computes their mip levels as
// matcap/view/level_of_detail.py does for a map set.

// Planes of a tile: diffuse 3, F0 (1, or 3 where it has a colour), roughness, height.
const planesOf = (channels) => 5 + channels;
// Moments: diffuse and F0, then alpha^2, slopes along x and y, sum of squared slopes, height.
const MORE = 3; // than planes of a tile

async function bytesOf(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// All planes as half floats, but height in steps.
export async function unpackTile({ size: [width, height], specular_channels, low, span, data }) {
  const bytes = await bytesOf(data);
  const planes = planesOf(specular_channels), count = width * height, words = bytes.length / 2;
  const tile = new Float32Array(planes * count);
  for (let i = 0; i < words; i++) {
    const word = bytes[i] | (bytes[words + i] << 8);
    tile[i] = i < (planes - 1) * count ? fromHalf(word) : low + (word / 65535) * span;
  }
  return tile;
}

function fromHalf(word) {
  const sign = word & 0x8000 ? -1 : 1, exponent = (word >> 10) & 31, rest = word & 1023;
  if (exponent === 0) return sign * rest * 2 ** -24;
  return sign * (1 + rest / 1024) * 2 ** (exponent - 15);
}

const wrapped = (value, side) => ((value % side) + side) % side;

export class Pyramid {
  // It repeats beyond its borders.
  constructor(tile, width, height, texelSize) {
    const count = width * height, rough = tile.length - 2 * count;
    this.ends = {
      specular: endsOf(tile.subarray(3 * count, rough)),
      roughness: endsOf(tile.subarray(rough, rough + count)),
      height: endsOf(tile.subarray(rough + count)),
    };
    this.levels = [{ width, height, data: momentsOf(tile, width, height, texelSize) }];
  }

  // Moments of a rectangle of a level.
  read(level, x, y, wide, tall) {
    while (this.levels.length <= level) this.levels.push(halved(this.levels.at(-1)));
    const { width, height, data } = this.levels[level];
    const moments = data.length / (width * height), alpha2 = moments - 5, more = alpha2 - 4;
    const metal = new Float32Array(more * wide * tall);
    const albedo = new Float32Array(4 * wide * tall), surface = new Float32Array(4 * wide * tall);
    const relief = new Float32Array(wide * tall);
    for (let row = 0, i = 0; row < tall; row++) {
      const line = wrapped(y + row, height) * width;
      for (let along = 0; along < wide; along++, i++) {
        const from = moments * (line + wrapped(x + along, width)), to = 4 * i;
        for (let c = 0; c < 4; c++) albedo[to + c] = data[from + c];
        for (let c = 0; c < more; c++) metal[more * i + c] = data[from + 4 + c];
        const rest = from + alpha2, sx = data[rest + 1], sy = data[rest + 2];
        surface[to] = data[rest];
        surface[to + 1] = sx;
        surface[to + 2] = sy;
        surface[to + 3] = Math.max(data[rest + 3] - sx * sx - sy * sy, 0);
        relief[i] = data[rest + 4];
      }
    }
    return { width: wide, height: tall, albedo, surface, relief, metal };
  }
}

function momentsOf(tile, width, height, texelSize) {
  const count = width * height, planes = tile.length / count, alpha2 = planes - 2;
  const rough = tile.subarray(alpha2 * count), heights = tile.subarray((planes - 1) * count);
  const step = 0.5 / texelSize, moments = new Float32Array((planes + MORE) * count);
  for (let y = 0, i = 0; y < height; y++) {
    const up = wrapped(y - 1, height) * width, down = wrapped(y + 1, height) * width;
    for (let x = 0; x < width; x++, i++) {
      const left = y * width + wrapped(x - 1, width), right = y * width + wrapped(x + 1, width);
      const at = (planes + MORE) * i, rest = at + alpha2;
      for (let c = 0; c < alpha2; c++) moments[at + c] = tile[c * count + i];
      const sx = (heights[right] - heights[left]) * step;
      const sy = (heights[up + x] - heights[down + x]) * step;
      moments[rest] = Math.max(rough[i], 1e-3) ** 4;
      moments[rest + 1] = sx;
      moments[rest + 2] = sy;
      moments[rest + 3] = sx * sx + sy * sy;
      moments[rest + 4] = heights[i];
    }
  }
  return moments;
}

// Averages of 2 x 2 texels; an odd side is doubled first.
function halved({ width, height, data }) {
  const wide = width % 2 ? width : width / 2, tall = height % 2 ? height : height / 2;
  const moments = data.length / (width * height), half = new Float32Array(moments * wide * tall);
  for (let y = 0; y < tall; y++) {
    for (let x = 0; x < wide; x++) {
      const columns = [(2 * x) % width, (2 * x + 1) % width];
      const to = moments * (y * wide + x);
      for (const row of [(2 * y) % height, (2 * y + 1) % height]) {
        for (const column of columns) {
          const from = moments * (row * width + column);
          for (let c = 0; c < moments; c++) half[to + c] += 0.25 * data[from + c];
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
