// Sources of pages: the server, or the tile inside this document. A page is {levels, texelSize,
// ends}; each level has width and height, albedo and F0, surface (alpha^2, slopes along x and y,
// slope variance), relief (height) and metal (green and blue of a coloured F0, whose red is next to
// the albedo; else empty).

import { Pyramid, unpackTile } from "./tile.js";

export class ServedPages {
  constructor(about) {
    this.form = about.page;
    this.most = 3; // asked at once: two that the server makes side by side, and one on its way
  }

  async load({ level, column, row }, { seed, share }, signal) {
    const query = new URLSearchParams({ level, column, row, seed, share });
    const answer = await fetch(`page?${query}`, { signal });
    if (!answer.ok) throw new Error((await answer.text()).slice(0, 200));
    return pageOf(answer, this.form);
  }
}

// The page of a server's answer.
export async function pageOf(answer, form) {
  const data = await answer.arrayBuffer();
  const about = JSON.parse(answer.headers.get("X-Page"));
  const levels = cut(data, form, about.specular_channels);
  return { levels, texelSize: about.texel_size, ends: about.ends };
}

// Split a page's bytes into its levels.
function cut(data, { width, height, apron, mips }, channels) {
  let at = 0;
  const take = (Kind, count) => {
    const part = new Kind(data, at, count);
    at += part.byteLength;
    return part;
  };
  return Array.from({ length: mips }, (_, mip) => {
    const wide = (width + 2 * apron) >> mip, tall = (height + 2 * apron) >> mip;
    const count = wide * tall;
    return {
      width: wide, height: tall,
      albedo: take(Uint16Array, 4 * count),
      surface: take(Float32Array, 4 * count),
      relief: take(Float32Array, count),
      metal: take(Uint16Array, (channels - 1) * count),
    };
  });
}

export class EnclosedPages {
  constructor(about) {
    this.form = about.page;
    this.most = 1;
    this.texelSize = about.texel_size;
    const [width, height] = about.tile.size;
    this.pyramid = unpackTile(about.tile).then(
      (tile) => new Pyramid(tile, width, height, about.texel_size),
    );
  }

  async load({ level, column, row }) {
    const pyramid = await this.pyramid;
    const { width, height, apron, mips } = this.form;
    const levels = Array.from({ length: mips }, (_, mip) => pyramid.read(
      level + mip,
      (column * width - apron) / 2 ** mip, (row * height - apron) / 2 ** mip,
      (width + 2 * apron) >> mip, (height + 2 * apron) >> mip,
    ));
    return { levels, texelSize: this.texelSize, ends: pyramid.ends };
  }
}
