"use strict";
// A window onto the endless plane: textures of slots x slots blocks that wrap around. Block
// (column, row) lies in slot (column mod slots, row mod slots), so that moving on overwrites what
// was left behind, and nothing is ever shifted. Beside each block come its own smaller levels: a
// block's texels are averaged as matcap/relight/sampling.py averages them, slopes into roughness.
//
// Of the surface four numbers are kept: alpha squared, both slopes, and the mean of their squares,
// from which the texture's fourth, their variance, follows.

const FADE = 180; // milliseconds in which a block appears
// A map's shown range is never narrower, or a flat map would show its rounding noise.
const LEAST_RANGE = { specular: 0.02, roughness: 0.05, height: 0.002 };
const JOINED = 7; // levels in which sides shared by blocks are set right; coarser, nothing shows

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
      }
    }
    for (let j = 0; j < 4 * count; j += 4) surface[j + 3] = surface[j + 1] ** 2 + surface[j + 2] ** 2;
    const number = this.slot(column, row);
    const ends = { specular: 3, roughness: 4, height: 5 };
    for (const [map, plane] of Object.entries(ends)) {
      ends[map] = endsOf(planes.subarray(plane * count, (plane + 1) * count));
    }
    const block = { column, row, born: now, ends, step, edges: edgesOf(height, side) };
    this.blocks.set(number, block);
    const x = (number % this.slots) * side, y = Math.floor(number / this.slots) * side;
    let heights = height;
    for (let level = 0, wide = side; level < this.levels; level++, wide /= 2) {
      if (level > 0) {
        albedo = halved(albedo, wide, 4);
        surface = halved(surface, wide, 4);
        heights = halved(heights, wide, 1);
      }
      if (level < JOINED) keepSides(block.edges, surface, wide);
      const put = (texture, format, data) => {
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texSubImage2D(
          gl.TEXTURE_2D, level, x >> level, y >> level, wide, wide, format, gl.FLOAT, data,
        );
      };
      put(this.albedo, gl.RGBA, albedo);
      put(this.surface, gl.RGBA, level > 0 ? withVariance(surface) : smooth(surface));
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

  // Lowest and highest value of a map in all blocks, and never less apart than can be told.
  range(map) {
    let low = Infinity, high = -Infinity;
    for (const { ends } of this.blocks.values()) {
      low = Math.min(low, ends[map][0]);
      high = Math.max(high, ends[map][1]);
    }
    if (high < low) return [0, 1];
    const short = Math.max(LEAST_RANGE[map] - (high - low), 0);
    return [low - short / 2, high + short / 2];
  }

  // Slopes along a side that two blocks share, now that the heights on both are known.
  #join(block, column, row, mine, theirs) {
    if (!this.has(column, row)) return;
    const other = this.blocks.get(this.slot(column, row));
    const slope = UPRIGHT[mine] ? 1 : 2;
    const sign = mine === "right" || mine === "top" ? 1 : -1;
    for (const [one, name, far, facing, way] of [
      [block, mine, other, theirs, sign],
      [other, theirs, block, mine, -sign],
    ]) {
      const edge = one.edges[name], beyond = far.edges[facing].outer;
      const slopes = edge.inner.map((inner, i) => way * (beyond[i] - inner) * one.step);
      changeSide(edge.lines, slopes, slope);
      shareCorners(one.edges, name);
      const crossing = UPRIGHT[name] ? ["top", "bottom"] : ["left", "right"];
      for (const changed of [name, ...crossing]) this.#putSide(one, changed);
    }
  }

  #putSide(block, name) {
    const { gl, side } = this;
    const number = this.slot(block.column, block.row);
    gl.bindTexture(gl.TEXTURE_2D, this.surface);
    block.edges[name].lines.forEach((line, level) => {
      const wide = side >> level;
      const x = (number % this.slots) * wide + (name === "right" ? wide - 1 : 0);
      const y = Math.floor(number / this.slots) * wide + (name === "bottom" ? wide - 1 : 0);
      const [across, down] = UPRIGHT[name] ? [1, wide] : [wide, 1];
      const data = level > 0 ? withVariance(line) : smooth(line);
      gl.texSubImage2D(gl.TEXTURE_2D, level, x, y, across, down, gl.RGBA, gl.FLOAT, data);
    });
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

function endsOf(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

const UPRIGHT = { left: true, right: true, top: false, bottom: false };

// Where a side's texels start in a map of `wide` x `wide`, how far apart they are, and how far it
// is inwards from them.
function sideOf(name, wide) {
  return {
    left: [0, wide, 1],
    right: [wide - 1, wide, -1],
    top: [0, 1, wide],
    bottom: [(wide - 1) * wide, 1, -wide],
  }[name];
}

// For each side of a block: heights of its outermost and its second line, and room for the surface
// along it, level by level.
function edgesOf(height, side) {
  const edges = {};
  for (const name of Object.keys(UPRIGHT)) {
    const [start, stride, inwards] = sideOf(name, side);
    const line = (from) => Float32Array.from({ length: side }, (_, i) => height[from + i * stride]);
    edges[name] = { outer: line(start), inner: line(start + inwards), lines: [] };
  }
  return edges;
}

function keepSides(edges, surface, wide) {
  for (const [name, { lines }] of Object.entries(edges)) {
    const [start, stride] = sideOf(name, wide);
    const line = new Float32Array(4 * wide);
    for (let i = 0; i < wide; i++) {
      const at = 4 * (start + i * stride);
      line.set(surface.subarray(at, at + 4), 4 * i);
    }
    lines.push(line);
  }
}

// Give the texels of a side new slopes; every coarser level changes by the mean of its changes.
function changeSide(lines, slopes, slope) {
  let change = new Float32Array(slopes.length), squares = new Float32Array(slopes.length);
  lines.forEach((line, level) => {
    if (level > 0) [change, squares] = [change, squares].map(halvedChange);
    for (let i = 0, at = 0; i < change.length; i++, at += 4) {
      if (level === 0) {
        change[i] = slopes[i] - line[at + slope];
        squares[i] = slopes[i] ** 2 - line[at + slope] ** 2;
      }
      line[at + slope] += change[i];
      line[at + 3] += squares[i];
    }
  });
}

// Of the four texels that make one of the next level, two lie on the side.
function halvedChange(change) {
  return Float32Array.from({ length: change.length / 2 },
    (_, i) => 0.25 * (change[2 * i] + change[2 * i + 1]));
}

// A corner's texel lies on two sides.
function shareCorners(edges, changed) {
  const [first, second] = UPRIGHT[changed] ? ["top", "bottom"] : ["left", "right"];
  edges[changed].lines.forEach((line, level) => {
    const last = line.length - 4;
    const end = changed === "right" || changed === "bottom" ? last : 0;
    edges[first].lines[level].set(line.subarray(0, 4), end);
    edges[second].lines[level].set(line.subarray(last), end);
  });
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

// What slopes vary within a coarse texel is roughness from afar.
function withVariance(surface) {
  const stored = surface.slice();
  for (let j = 0; j < stored.length; j += 4) {
    stored[j + 3] = Math.max(0, stored[j + 3] - stored[j + 1] ** 2 - stored[j + 2] ** 2);
  }
  return stored;
}

// Within the finest texels nothing varies.
function smooth(surface) {
  const stored = surface.slice();
  for (let j = 3; j < stored.length; j += 4) stored[j] = 0;
  return stored;
}
