"use strict";
// Where blocks come from: the server, or the tile inside this document. A block is {planes,
// texelSize}: six maps of side x side numbers (diffuse 3, specular, roughness, height).

class ServedBlocks {
  constructor(about) {
    this.side = about.side;
    this.most = 2; // asked at once: as many as the server decodes side by side on two cores
  }

  async load(column, row, seed, share, signal) {
    const query = new URLSearchParams({ column, row, seed, share });
    const answer = await fetch(`block?${query}`, { signal });
    if (!answer.ok) throw new Error((await answer.text()).slice(0, 200));
    const planes = new Float32Array(await answer.arrayBuffer());
    return { planes, texelSize: Number(answer.headers.get("X-Texel-Size")) };
  }
}

class EnclosedBlocks {
  constructor(about) {
    this.side = about.side;
    this.most = 1;
    this.texelSize = about.texel_size;
    this.size = about.tile.size;
    this.tile = unpackTile(about.tile);
  }

  async load(column, row) {
    const tile = await this.tile, { side } = this, [width, height] = this.size;
    const planes = new Float32Array(6 * side * side);
    const wrap = (value, period) => ((value % period) + period) % period;
    for (let y = 0; y < side; y++) {
      const from = wrap(row * side + y, height) * width;
      const left = wrap(column * side, width);
      for (let p = 0; p < 6; p++) {
        const start = p * width * height + from, to = (p * side + y) * side;
        for (let x = 0, at = left; x < side; x++, at = at + 1 === width ? 0 : at + 1) {
          planes[to + x] = tile[start + at];
        }
      }
    }
    return { planes, texelSize: this.texelSize };
  }
}

// The document's tile (see _packed in document.py): five maps in half floats, the height in steps.
async function unpackTile({ size: [width, height], low, span, data }) {
  const text = atob(data);
  const packed = Uint8Array.from(text, (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = width * height, words = bytes.length / 2;
  const tile = new Float32Array(6 * count);
  for (let i = 0; i < words; i++) {
    const word = bytes[i] | (bytes[words + i] << 8);
    tile[i] = i < 5 * count ? fromHalf(word) : low + (word / 65535) * span;
  }
  return tile;
}

function fromHalf(word) {
  const sign = word & 0x8000 ? -1 : 1, exponent = (word >> 10) & 31, rest = word & 1023;
  if (exponent === 0) return sign * rest * 2 ** -24;
  return sign * (1 + rest / 1024) * 2 ** (exponent - 15);
}
