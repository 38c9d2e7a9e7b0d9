// Cache of pages on the GPU. A page is a rectangle of the plane at a level (texels 2^k wide), with
// an apron and its own mip levels. Pages are stored in layers of texture arrays; a table has, for
// every visible cell, the layer of the best available page.

export const CELLS = 64; // cells of the table along either side; it wraps around
const UPWARDS = 24; // levels that a cell looks up for something coarser
// Least displayed range of a map; a flat map would otherwise show rounding noise.
export const LEAST_RANGE = { specular: 0.02, roughness: 0.05, height: 0.002 };

export class Pages {
  constructor(gl, form, count) {
    Object.assign(this, { gl, form, count });
    this.held = new Map(); // key -> {slot, level, column, row, used, ends, coloured}
    this.free = Array.from({ length: count }, (_, slot) => slot);
    this.turn = 0;
    const fine = gl.getExtension("OES_texture_float_linear");
    this.albedo = this.#array(gl.RGBA16F);
    this.surface = this.#array(fine ? gl.RGBA32F : gl.RGBA16F);
    this.relief = this.#array(fine ? gl.R32F : gl.R16F);
    this.metal = null; // made when the first page of a coloured F0 comes
    this.entries = new Float32Array(CELLS * CELLS * 8);
    this.table = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, 2 * CELLS, CELLS);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  }

  // Bind textures and table for drawing.
  bind(units) {
    const { gl } = this;
    for (const name of ["albedo", "surface", "relief", "metal", "table"]) {
      gl.activeTexture(gl.TEXTURE0 + units[name]);
      gl.bindTexture(name === "table" ? gl.TEXTURE_2D : gl.TEXTURE_2D_ARRAY, this[name]);
    }
    gl.activeTexture(gl.TEXTURE0 + units.spare);
  }

  static key(level, column, row) {
    return `${level} ${column} ${row}`;
  }

  has(level, column, row) {
    return this.held.has(Pages.key(level, column, row));
  }

  clear() {
    this.free = Array.from({ length: this.count }, (_, slot) => slot);
    this.held.clear();
  }

  // Pages that are visible now are evicted last.
  use(places) {
    this.turn += 1;
    for (const { level, column, row } of places) {
      const page = this.held.get(Pages.key(level, column, row));
      if (page) page.used = this.turn;
    }
  }

  put(level, column, row, { levels, ends }) {
    const { gl } = this, slot = this.#room();
    if (slot === undefined) return;
    const coloured = levels[0].metal.length > 0;
    if (coloured) this.metal ||= this.#array(gl.RG16F);
    levels.forEach(({ width, height, albedo, surface, relief, metal }, mip) => {
      const fill = (texture, format, data) => {
        gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
        const type = data instanceof Uint16Array ? gl.HALF_FLOAT : gl.FLOAT;
        gl.texSubImage3D(
          gl.TEXTURE_2D_ARRAY, mip, 0, 0, slot, width, height, 1, format, type, data,
        );
      };
      fill(this.albedo, gl.RGBA, albedo);
      fill(this.surface, gl.RGBA, surface);
      fill(this.relief, gl.RED, relief);
      if (coloured) fill(this.metal, gl.RG, metal);
    });
    const page = { slot, level, column, row, used: this.turn, ends, coloured };
    this.held.set(Pages.key(level, column, row), page);
  }

  // Write the table for cells of a level. A page of level `best` is preferred to one of the cell's own
  // level, and that to coarser ones.
  update(level, best, columns, rows) {
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        this.#tell(level, column, row, this.#above(level, best, column, row));
      }
    }
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texSubImage2D(
      gl.TEXTURE_2D, 0, 0, 0, 2 * CELLS, CELLS, gl.RGBA, gl.FLOAT, this.entries,
    );
  }

  // Least and greatest value of a map over all pages, at least the displayed range apart.
  range(map) {
    let low = Infinity, high = -Infinity;
    for (const { ends, used } of this.held.values()) {
      if (used < this.turn) continue;
      low = Math.min(low, ends[map][0]);
      high = Math.max(high, ends[map][1]);
    }
    if (high < low) return [0, 1];
    const short = Math.max(LEAST_RANGE[map] - (high - low), 0);
    return [low - short / 2, high + short / 2];
  }

  // The best page for a cell, or undefined.
  #above(level, best, column, row) {
    const order = best > level ? [best, level] : [level];
    for (let up = Math.max(best, level) + 1; up <= level + UPWARDS; up++) order.push(up);
    for (const one of order) {
      const step = 2 ** (one - level);
      const key = Pages.key(one, Math.floor(column / step), Math.floor(row / step));
      const page = this.held.get(key);
      if (page) return page;
    }
    return undefined;
  }

  #tell(level, column, row, page) {
    const at = cellAt(column, row);
    if (!page) { this.entries[at] = -1; return; }
    const scale = 2 ** (level - page.level);
    this.entries.set([page.slot, column * scale - page.column, row * scale - page.row, scale,
      page.level, page.coloured ? 1 : 0], at);
  }

  #room() {
    if (this.free.length) return this.free.pop();
    let oldest = null;
    for (const [key, page] of this.held) {
      if (page.used < this.turn && (!oldest || page.used < oldest[1].used)) oldest = [key, page];
    }
    if (!oldest) return undefined;
    this.held.delete(oldest[0]);
    return oldest[1].slot;
  }

  #array(format) {
    const { gl, form } = this, texture = gl.createTexture();
    const width = form.width + 2 * form.apron, height = form.height + 2 * form.apron;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, form.mips, format, width, height, this.count);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }
}

function cellAt(column, row) {
  const wrap = (value) => ((value % CELLS) + CELLS) % CELLS;
  return 8 * (wrap(row) * CELLS + wrap(column));
}
