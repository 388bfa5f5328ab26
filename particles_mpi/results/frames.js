"use strict";
// What a page holds: the header of the run, and its frames, unpacked when they are shown; what the user has chosen.

const $ = name => document.getElementById(name);
const run = JSON.parse($("header").textContent), blocks = JSON.parse($("frames").textContent);
const TYPES = {f4: Float32Array, f8: Float64Array, i4: Int32Array, u1: Uint8Array, u2: Uint16Array};
const PAINTS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#888888"];  // Okabe and Ito's
const DASHES = [[], [6, 3], [2, 3]];
const LABELS = {energy: "kinetic energy"};
const origin = [0, 1, 2].map(k => 0.5 * (run.extent[0][k] + run.extent[1][k]));
const sides = [0, 1, 2].map(k => run.extent[1][k] - run.extent[0][k]);
const state = {frame: 0, playing: false, color: "speed", map: "viridis", log: false, fit: false, grow: 1, box: true, walls: true, dark: true,
               trails: run.trails, rate: Math.max(4, Math.min(30, Math.ceil(run.times.length / 10))), picked: null};
const short = x => !isFinite(x) ? "–" : x === 0 ? "0"
  : Math.abs(x) >= 1e6 || Math.abs(x) < 1e-3 ? x.toExponential(2).replace(/\.?0+e/, "e") : +x.toPrecision(4) + "";
const spaced = n => n.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

function widened(low, high) {  // round-off in a constant is not blown up to the full height
  const most = Math.max(Math.abs(low), Math.abs(high)) || 1;
  return high - low > 1e-9 * most ? [low, high] : [low - 0.5 * most, high + 0.5 * most];
}

function ticks(low, high) {  // round numbers from low to high
  if (!(high > low)) return [low];
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough)), step = power * [1, 2, 5, 10].find(k => k * power >= rough);
  const found = [];
  for (let n = Math.ceil(low / step - 1e-9); n <= high / step + 1e-9; n++) found.push(+(n * step).toPrecision(12));
  return found;
}

function unpack(text, columns) {  // {count, raw: {name: numbers as stored}}
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  const count = new DataView(bytes.buffer).getInt32(0, true), raw = {};
  let place = 8;
  for (const {name, type} of columns) {
    if (!type) continue;
    raw[name] = new TYPES[type](bytes.buffer, place, count * (name === "position" ? 3 : 1));
    place += 8 * Math.ceil(raw[name].byteLength / 8);
  }
  return {count, raw};
}

const columnOf = name => run.columns.find(column => column.name === name);
const constant = unpack(run.constant, run.columns.filter(column => column.constant));
const kept = new Map();  // frames that are unpacked, the last few

function frameAt(k) {
  if (!kept.has(k)) {
    const frame = unpack(blocks[k], run.columns.filter(column => !column.constant));
    Object.assign(frame.raw, constant.raw);
    kept.set(k, frame);
    if (kept.size > 8 && !state.trails) kept.delete(kept.keys().next().value);
  }
  return kept.get(k);
}

function numbers(frame, name) {  // of each particle
  if (name === "energy") {
    const mass = numbers(frame, "mass"), speed = numbers(frame, "speed");
    return mass.map((m, i) => 0.5 * m * speed[i] * speed[i]);
  }
  const {offset, scale} = columnOf(name), raw = frame.raw[name];
  return offset === 0 && scale === 1 ? raw : Float64Array.from(raw, x => offset + scale * x);
}

function places(frame) {  // (3n), from the origin of the picture
  if (frame.places) return frame.places;
  const {offset, scale} = columnOf("position"), raw = frame.raw.position, made = new Float32Array(raw.length);
  const shift = offset.map((x, k) => x - origin[k]);
  for (let i = 0; i < made.length; i++) made[i] = shift[i % 3] + scale[i % 3] * raw[i];
  return frame.places = made;
}
