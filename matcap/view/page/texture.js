"use strict";
// A window onto the endless plane: textures of slots x slots blocks that wrap around. Block
// (column, row) lies in slot (column mod slots, row mod slots), so that moving on overwrites what
// was left behind, and nothing is ever shifted. Beside each block come its own smaller levels: a
// block's texels are averaged as matcap/relight/sampling.py averages them, slopes into roughness.

const FADE = 180; // milliseconds in which a block appears

class Window {
  constructor(gl, side, slots) {
    Object.assign(this, { gl, side, slots });
    this.levels = Math.log2(side) + 1;
    this.blocks = new Map(); // slot number -> {column, row, born, edges, low, high}
    const fine = gl.getExtension("OES_texture_float_linear");
    this.albedo = this.#texture(gl.RGBA16F);
    this.surface = this.#texture(fine ? gl.RGBA32F : gl.RGBA16F);
    this.relief = this.#texture(fine ? gl.R32F : gl.R16F);
    this.presence = this.#plain(gl.R8, slots);
  }

  slot(column, row) {
    const wrap = (value) => ((value % this.slots) + this.slots) % this.slots;
    return wrap(row) * this.slots + wrap(column);
  }

  has(column, row) {
    const block = this.blocks.get(this.slot(column, row));
    return block !== undefined && block.column === column && block.row === row;
  }

  clear() {
    this.blocks.clear();
  }

  put(column, row, { planes, texelSize }, now) {
    const { gl, side } = this;
    const count = side * side;
    const height = planes.subarray(5 * count);
    let albedo = new Float32Array(4 * count), surface = new Float32Array(4 * count);
    let low = Infinity, high = -Infinity;
    const step = 0.5 / texelSize;
    for (let y = 0, i = 0; y < side; y++) {
      const up = y > 0 ? -side : 0, down = y < side - 1 ? side : 0;
      const rise = down - up === 2 * side ? step : 2 * step;
      for (let x = 0; x < side; x++, i++) {
        const j = 4 * i;
        albedo[j] = planes[i];
        albedo[j + 1] = planes[count + i];
        albedo[j + 2] = planes[2 * count + i];
        albedo[j + 3] = planes[3 * count + i];
        const alpha = Math.max(planes[4 * count + i], 1e-3) ** 2;
        surface[j] = alpha * alpha;
        const left = x > 0 ? -1 : 0, right = x < side - 1 ? 1 : 0;
        surface[j + 1] = (height[i + right] - height[i + left]) * (right - left === 2 ? step : 2 * step);
        surface[j + 2] = (height[i + up] - height[i + down]) * rise;
        const h = height[i];
        if (h < low) low = h;
        if (h > high) high = h;
      }
    }
    const number = this.slot(column, row);
    const block = { column, row, born: now, low, high, step, edges: edgesOf(height, surface, side) };
    this.blocks.set(number, block);
    const x = (number % this.slots) * side, y = Math.floor(number / this.slots) * side;
    let heights = height;
    for (let level = 0, wide = side; level < this.levels; level++, wide /= 2) {
      if (level > 0) {
        albedo = halved(albedo, wide, 4);
        surface = halvedSurface(surface, wide);
        heights = halved(heights, wide, 1);
      }
      const put = (texture, format, data) => {
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texSubImage2D(
          gl.TEXTURE_2D, level, x >> level, y >> level, wide, wide, format, gl.FLOAT, data,
        );
      };
      put(this.albedo, gl.RGBA, albedo);
      put(this.surface, gl.RGBA, surface);
      put(this.relief, gl.RED, heights);
    }
    this.#join(block, column - 1, row, "left", "right");
    this.#join(block, column + 1, row, "right", "left");
    this.#join(block, column, row - 1, "top", "bottom");
    this.#join(block, column, row + 1, "bottom", "top");
  }

  // Which of the wanted blocks are there, and how far they have appeared; true while some appear.
  update(columns, rows, now, fades) {
    const { gl, slots } = this;
    const there = new Uint8Array(slots * slots);
    let appearing = false;
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        if (!this.has(column, row)) continue;
        const number = this.slot(column, row);
        const age = fades ? Math.min(1, (now - this.blocks.get(number).born) / FADE) : 1;
        there[number] = Math.round(255 * age);
        appearing ||= age < 1;
      }
    }
    gl.bindTexture(gl.TEXTURE_2D, this.presence);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, slots, slots, gl.RED, gl.UNSIGNED_BYTE, there);
    return appearing;
  }

  heights() {
    let low = Infinity, high = -Infinity;
    for (const block of this.blocks.values()) {
      low = Math.min(low, block.low);
      high = Math.max(high, block.high);
    }
    return high > low ? [low, high] : [low - 0.5, low + 0.5];
  }

  // Slopes along a side that two blocks share, now that the heights on both are known.
  #join(block, column, row, mine, theirs) {
    if (!this.has(column, row)) return;
    const other = this.blocks.get(this.slot(column, row));
    const across = mine === "left" || mine === "right";
    const sign = mine === "right" || mine === "top" ? 1 : -1;
    for (const [one, name, far, facing, way] of [
      [block, mine, other, theirs, sign],
      [other, theirs, block, mine, -sign],
    ]) {
      const edge = one.edges[name], beyond = far.edges[facing];
      for (let i = 0; i < this.side; i++) {
        edge.texels[4 * i + (across ? 1 : 2)] = way * (beyond.outer[i] - edge.inner[i]) * one.step;
      }
      shareCorners(one.edges, name, this.side);
      for (const changed of sidesOf(name)) this.#putEdge(one, changed);
    }
  }

  #putEdge(block, name) {
    const { gl, side } = this;
    const number = this.slot(block.column, block.row);
    const x = (number % this.slots) * side + (name === "right" ? side - 1 : 0);
    const y = Math.floor(number / this.slots) * side + (name === "bottom" ? side - 1 : 0);
    const upright = name === "left" || name === "right";
    gl.bindTexture(gl.TEXTURE_2D, this.surface);
    gl.texSubImage2D(
      gl.TEXTURE_2D, 0, x, y, upright ? 1 : side, upright ? side : 1, gl.RGBA, gl.FLOAT,
      block.edges[name].texels,
    );
  }

  #texture(format) {
    const { gl } = this;
    const texture = this.#made();
    gl.texStorage2D(gl.TEXTURE_2D, this.levels, format, this.slots * this.side, this.slots * this.side);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    return texture;
  }

  #plain(format, size) {
    const { gl } = this;
    const texture = this.#made();
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, size, size);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  #made() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    return texture; // wrapping around is WebGL's default
  }
}

// For each side of a block: heights of its outermost and second line, and its surface texels.
function edgesOf(height, surface, side) {
  const edge = (start, stride, inwards) => {
    const outer = new Float32Array(side), inner = new Float32Array(side);
    const texels = new Float32Array(4 * side);
    for (let i = 0; i < side; i++) {
      const at = start + i * stride;
      outer[i] = height[at];
      inner[i] = height[at + inwards];
      texels.set(surface.subarray(4 * at, 4 * at + 4), 4 * i);
    }
    return { outer, inner, texels };
  };
  return {
    left: edge(0, side, 1),
    right: edge(side - 1, side, -1),
    top: edge(0, 1, side),
    bottom: edge((side - 1) * side, 1, -side),
  };
}

// A corner texel lies on two sides; the side just changed knows one of its slopes.
function shareCorners(edges, changed, side) {
  const last = 4 * (side - 1);
  const upright = changed === "left" || changed === "right";
  const [first, second] = upright ? ["top", "bottom"] : ["left", "right"];
  const end = changed === "right" || changed === "bottom" ? last : 0;
  const slope = upright ? 1 : 2;
  edges[first].texels[end + slope] = edges[changed].texels[slope];
  edges[second].texels[end + slope] = edges[changed].texels[last + slope];
}

function sidesOf(changed) {
  return changed === "left" || changed === "right"
    ? [changed, "top", "bottom"]
    : [changed, "left", "right"];
}

function halved(data, wide, channels) {
  const half = new Float32Array(wide * wide * channels), row = 2 * wide * channels;
  for (let y = 0, to = 0; y < wide; y++) {
    for (let x = 0; x < wide; x++) {
      const from = 2 * y * row + 2 * x * channels;
      for (let c = 0; c < channels; c++, to++) {
        half[to] = 0.25 * (data[from + c] + data[from + channels + c]
          + data[from + row + c] + data[from + row + channels + c]);
      }
    }
  }
  return half;
}

// What slopes vary among the four is roughness from afar.
function halvedSurface(data, wide) {
  const half = halved(data, wide, 4), row = 8 * wide;
  for (let y = 0, to = 0; y < wide; y++) {
    for (let x = 0; x < wide; x++, to += 4) {
      const from = 2 * y * row + 8 * x;
      let square = 0;
      for (const at of [from, from + 4, from + row, from + row + 4]) {
        square += data[at + 1] ** 2 + data[at + 2] ** 2 + data[at + 3];
      }
      half[to + 3] = Math.max(0, square / 4 - half[to + 1] ** 2 - half[to + 2] ** 2);
    }
  }
  return half;
}
