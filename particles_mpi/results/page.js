"use strict";
// The page of a run: reads the frames, draws one of them with `Spheres`, and lets the user choose what, when and from where.

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

function ticks(low, high) {  // round numbers from low to high
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough)), step = power * [1, 2, 5, 10].find(k => k * power >= rough);
  const found = [];
  for (let n = Math.ceil(low / step - 1e-9); n <= high / step + 1e-9; n++) found.push(+(n * step).toPrecision(12));
  return found;
}

// --- frames ------------------------------------------------------------------------------------------------------------

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

// --- what is drawn -----------------------------------------------------------------------------------------------------

const canvas = $("canvas"), over = $("over").getContext("2d");
let spheres, camera;

function range() {
  let {low, high} = columnOf(state.color);
  if (state.fit) [low, high] = numbers(frameAt(state.frame), state.color).reduce(([a, b], x) => [Math.min(a, x), Math.max(b, x)], [Infinity, -Infinity]);
  if (state.log) {
    if (!(high > 0)) high = 1;
    low = Math.max(low, high * 1e-6);
  }
  return [low, high > low ? high : low + (Math.abs(low) || 1)];
}

function share(x, low, high) {  // 0 to 1
  return state.log ? (x > 0 ? Math.log(x / low) / Math.log(high / low) : 0) : (x - low) / (high - low);
}

function show(k) {
  state.frame = Math.max(0, Math.min(run.times.length - 1, k));
  const frame = frameAt(state.frame), [low, high] = range();
  const values = Float32Array.from(numbers(frame, state.color), x => share(x, low, high));
  const radii = Float32Array.from(numbers(frame, "radius")), rims = new Float32Array(frame.count);
  if (frame.raw.fixed) rims.set(frame.raw.fixed);
  spheres.setSpheres(places(frame), radii, values, rims);
  $("frame").value = state.frame;
  if (state.fit) drawBar();
  $("clock").textContent = `t = ${+run.times[state.frame].toPrecision(6)}`;
  $("number").textContent = `frame ${run.numbers[state.frame]} · ${spaced(frame.count)} particles`;
  document.body.dataset.frame = state.frame;
  draw();
  drawCurves();
}

const hex = (color, alpha = 1) => [1, 3, 5].map(i => parseInt(color.slice(i, i + 2), 16) / 255).concat(alpha);
const corner = bits => [0, 1, 2].map(k => (bits >> k & 1 ? run.box.upper : run.box.lower)[k] - origin[k]);

function boxLines() {
  const grey = state.dark ? 0.62 : 0.35, lines = [];
  for (let axis = 0; axis < 3; axis++)
    for (let bits = 0; bits < 8; bits++)
      if (!(bits >> axis & 1)) {
        const others = [0, 1, 2].filter(k => k !== axis), [a, b] = [corner(bits), corner(bits | 1 << axis)];
        const dashed = !run.box.real || others.every(k => run.periodic[k] || a[k] === b[k]) && others.some(k => run.periodic[k]);
        const parts = dashed ? 40 : 1;  // periodic edges are dashed
        for (let p = 0; p < parts; p += 2) {
          const at = s => a.map((x, k) => x + (b[k] - x) * s);
          lines.push([[at(p / parts), at((p + 1) / parts)], [grey, grey, grey, 0.9]]);
        }
      }
  return lines;
}

function trailLines() {
  const paths = new Map(), lines = [];
  for (let k = Math.max(0, state.frame - 400); k <= state.frame; k++) {
    const frame = frameAt(k), at = places(frame), ids = frame.raw.id;
    for (let i = 0; i < frame.count; i++) {
      if (!paths.has(ids[i])) paths.set(ids[i], []);
      const path = paths.get(ids[i]), now = [at[3 * i], at[3 * i + 1], at[3 * i + 2]], last = path.at(-1);
      const jumped = last && run.periodic.some((periodic, axis) => periodic && Math.abs(now[axis] - last[axis]) > 0.5 * sides[axis]);
      if (jumped) {
        lines.push([path.slice(), ids[i]]);
        path.length = 0;
      }
      path.push(now);
    }
  }
  for (const [id, path] of paths) lines.push([path, id]);
  return lines.map(([path, id]) => {
    const color = PAINTS[id % (PAINTS.length - 1)];
    return [path, path.map((_, k) => hex(color, 0.15 + 0.85 * (k + 1) / path.length))];
  });
}

function draw() {
  const ground = state.dark ? [0.075, 0.09, 0.115] : [0.965, 0.97, 0.98];
  const lines = [...(state.box ? boxLines() : []), ...(state.trails ? trailLines() : [])], faces = [];
  if (state.walls)
    for (const {corners} of run.walls) {
      const path = corners.map(point => point.map((x, k) => x - origin[k]));
      if (path.length > 2) faces.push([path, [0.55, 0.65, 0.8, 0.28]]);
      lines.push([[...path, path[0]], [0.55, 0.65, 0.8, 1]]);
    }
  spheres.draw(camera, {lines, faces, ground, grow: state.grow, smallest: columnOf("radius").high > 0 ? 1 : run.trails ? 4 : 1.5});
  annotate();
}

function project(point) {  // place of a point on the canvas, and its distance; null behind the viewer
  const {view, projection} = camera.matrices(canvas.width / canvas.height), times = (m, [x, y, z, w]) =>
    [0, 1, 2, 3].map(r => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r] * w);
  const eye = times(view, [...point, 1]), [x, y, , w] = times(projection, eye);
  return w <= 0 ? null : [(0.5 + 0.5 * x / w) * canvas.clientWidth, (0.5 - 0.5 * y / w) * canvas.clientHeight, Math.hypot(eye[0], eye[1], eye[2])];
}

function annotate() {  // names and numbers of the axes, and who was clicked on
  over.clearRect(0, 0, canvas.width, canvas.height);
  over.font = "12px system-ui, sans-serif";
  over.textAlign = "center";
  over.fillStyle = over.strokeStyle = state.dark ? "#aab4c2" : "#4a5260";
  if (state.box) {
    const middle = project(corner(0).map((x, k) => 0.5 * (x + corner(7)[k])));
    for (let axis = 0; axis < (camera.flat ? 2 : 3); axis++) labelEdge(axis, middle);
  }
  const picked = pickedNow();
  $("picked").hidden = !picked;
  if (!picked) return;
  $("picked").textContent = picked.told;
  const at = project(picked.place);
  if (!at) return;
  over.strokeStyle = state.dark ? "#ffffff" : "#000000";
  over.beginPath();
  over.arc(at[0], at[1], Math.max(7, picked.radius / (camera.pixel(canvas.clientHeight) * (camera.flat ? 1 : at[2])) + 3), 0, 7);
  over.stroke();
}

function labelEdge(axis, middle) {  // at the outermost of its four edges: the lowest for x and y, the leftmost for z
  const edges = [0, 1, 2, 3].map(n => [0, 1, 2].filter(k => k !== axis).reduce((bits, k, i) => bits | (n >> i & 1) << k, 0))
    .map(bits => [project(corner(bits)), project(corner(bits | 1 << axis))]).filter(([a, b]) => a && b);
  if (!edges.length || !middle) return;
  const leftmost = axis === 2 || (camera.flat && axis === 1), key = ([a, b]) => leftmost ? a[0] + b[0] : -(a[1] + b[1]);
  const [a, b] = edges.reduce((best, edge) => key(edge) < key(best) ? edge : best);
  const [dx, dy] = [b[1] - a[1], a[0] - b[0]], length = Math.hypot(dx, dy);
  if (length < 40) return;
  const side = Math.sign(dx * (0.5 * (a[0] + b[0]) - middle[0]) + dy * (0.5 * (a[1] + b[1]) - middle[1])) || 1;
  for (const [s, text] of [[0.06, short(run.box.lower[axis])], [0.5, "xyz"[axis]], [0.94, short(run.box.upper[axis])]])
    over.fillText(text, a[0] + s * (b[0] - a[0]) + side * 17 * dx / length, a[1] + s * (b[1] - a[1]) + side * 15 * dy / length + 4);
}

function pickedNow() {
  if (state.picked === null) return null;
  const frame = frameAt(state.frame), i = frame.raw.id.indexOf(state.picked);
  if (i < 0) return null;
  const at = places(frame), place = [at[3 * i], at[3 * i + 1], at[3 * i + 2]];
  const told = choices().filter(name => name !== "id").map(name => `${LABELS[name] || name} ${short(Number(numbers(frame, name)[i]))}`);
  const there = place.slice(0, run.planar ? 2 : 3).map((x, k) => short(x + origin[k])).join(", ");
  return {place, radius: numbers(frame, "radius")[i] * state.grow, told: `particle ${state.picked} at (${there}): ${told.join(", ")}`};
}

function pick(x, y) {  // the nearest sphere under a point of the canvas
  const frame = frameAt(state.frame), at = places(frame), radii = numbers(frame, "radius"), unit = camera.pixel(canvas.clientHeight);
  let best = null;
  for (let i = 0; i < frame.count; i++) {
    const seen = project([at[3 * i], at[3 * i + 1], at[3 * i + 2]]);
    const size = seen && Math.max(4, radii[i] * state.grow / (unit * (camera.flat ? 1 : seen[2])));
    if (seen && Math.hypot(seen[0] - x, seen[1] - y) < size && (!best || seen[2] < best[0])) best = [seen[2], frame.raw.id[i]];
  }
  state.picked = best && best[1];
}

function drawBar() {
  const bar = $("bar").getContext("2d"), colors = bytesOf(run.maps[state.map]), [low, high] = range(), {height} = $("bar");
  for (let y = 0; y < height; y++) {
    const k = 3 * Math.round(255 * (1 - y / (height - 1)));
    bar.fillStyle = `rgb(${colors[k]},${colors[k + 1]},${colors[k + 2]})`;
    bar.fillRect(0, y, 20, 1);
  }
  const marks = state.log ? [0, 1, 2, 3, 4].map(k => low * (high / low) ** (k / 4)) : ticks(low, high);
  $("ticks").replaceChildren(...marks.map(x => {
    const mark = make("span", short(x));
    mark.style.bottom = `${100 * share(x, low, high)}%`;
    return mark;
  }));
}

const bytesOf = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));

// --- curves ------------------------------------------------------------------------------------------------------------

function drawCurves() {
  run.curves.forEach((panel, n) => drawPanel($("curves").children[n].querySelector("canvas"), panel));
}

function drawPanel(canvas, {time, lines}) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight, pen = canvas.getContext("2d");
  if (!width) return;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  pen.scale(ratio, ratio);
  const all = Object.values(lines).flat(), left = 58, right = width - 8, top = 8, bottom = height - 18;
  let [low, high] = [Math.min(...all), Math.max(...all)];
  if (high - low < 1e-9 * Math.max(Math.abs(low), Math.abs(high), 1e-300)) [low, high] = [low - (Math.abs(low) || 1) * 0.5, high + (Math.abs(high) || 1) * 0.5];
  const x = t => left + (right - left) * (t - time[0]) / (time.at(-1) - time[0] || 1), y = v => bottom - (bottom - top) * (v - low) / (high - low);
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = "#5c6673";
  pen.strokeStyle = "#e3e6ea";
  pen.textAlign = "right";
  for (const v of ticks(low, high)) {
    pen.fillText(short(v), left - 6, y(v) + 4);
    pen.beginPath(); pen.moveTo(left, y(v)); pen.lineTo(right, y(v)); pen.stroke();
  }
  pen.textAlign = "center";
  for (const t of ticks(time[0], time.at(-1))) pen.fillText(short(t), Math.min(x(t), width - 0.5 * pen.measureText(short(t)).width), height - 4);
  Object.values(lines).forEach((line, n) => {
    pen.strokeStyle = PAINTS[n % PAINTS.length];
    pen.lineWidth = 1.5;
    pen.setLineDash(DASHES[n % 3]);
    pen.beginPath();
    line.forEach((v, k) => pen.lineTo(x(time[k]), y(v)));
    pen.stroke();
  });
  pen.setLineDash([]);
  pen.strokeStyle = "#111";
  pen.lineWidth = 1;
  const now = x(run.times[state.frame]);
  pen.beginPath(); pen.moveTo(now, top - 4); pen.lineTo(now, bottom); pen.stroke();
}

function nearest(time) {
  return run.times.reduce((best, t, k) => Math.abs(t - time) < Math.abs(run.times[best] - time) ? k : best, 0);
}

// --- controls ----------------------------------------------------------------------------------------------------------

const choices = () => run.columns.map(column => column.name).filter(name => name !== "position" && name !== "fixed");

function make(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  made.textContent = text;
  return Object.assign(made, attributes);
}

function play(on) {
  state.playing = on;
  $("play").textContent = on ? "❚❚ Pause" : "► Play";
  if (on && state.frame === run.times.length - 1) show(0);
}

let shown = 0;
function tick(now) {
  if (state.playing && now - shown >= 1000 / state.rate) {
    shown = now;
    if (state.frame < run.times.length - 1) show(state.frame + 1);
    else if ($("again").checked) show(0);
    else play(false);
  }
  requestAnimationFrame(tick);
}

function resize() {
  const ratio = devicePixelRatio || 1;
  for (const one of [canvas, $("over")]) {
    one.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    one.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  }
  over.scale(ratio, ratio);
  draw();
  drawCurves();
}

function recolor() {
  spheres.setColors(bytesOf(run.maps[state.map]));
  drawBar();
  show(state.frame);
}

function view(azimuth, elevation) {
  camera.reset(sides, canvas.width / canvas.height);
  if (azimuth !== undefined) [camera.azimuth, camera.elevation] = [azimuth, elevation];
  draw();
}

function addFrame({block, time, number, columns, curves, constants}) {  // of a run that goes on, in a notebook
  run.columns = columns;
  run.curves = curves;
  blocks.push(block);
  run.times.push(time);
  run.numbers.push(number);
  $("frame").max = run.times.length - 1;
  tellCurves();
  drawBar();
  show(run.times.length - 1);
}

function tellCurves() {
  $("curves").replaceChildren(...run.curves.map(panel => {
    const figure = make("figure", ""), caption = make("figcaption", panel.title + " "), drawn = make("canvas", "", {title: "click: go to this time"});
    Object.keys(panel.lines).forEach((name, n) => {
      const key = make("span", ` ${["━", "╍", "┄"][n % 3]} ${name}`);
      key.style.color = PAINTS[n % PAINTS.length];
      caption.append(key);
    });
    drawn.onclick = event => {
      const part = (event.offsetX - 58) / (drawn.clientWidth - 66);
      show(nearest(panel.time[0] + part * (panel.time.at(-1) - panel.time[0])));
    };
    figure.append(caption, drawn);
    return figure;
  }));
}

function tell() {
  $("told").textContent = run.told.join(" · ");
  $("notes").replaceChildren(...run.notes.map(note => make("li", note)));
  const rows = run.effects.map(([name, law, calls]) => {
    const row = make("tr", "");
    row.append(make("td", name), make("td", law), make("td", calls === "" ? "" : spaced(calls)));
    return row;
  });
  $("effects").append(...rows);
  $("not_run").textContent = run.not_run.length ? `not run: ${run.not_run.join(", ")}` : "";
  tellCurves();
}

function listen() {
  $("frame").max = run.times.length - 1;
  $("frame").oninput = () => { play(false); show(+$("frame").value); };
  $("play").onclick = () => play(!state.playing);
  for (const element of [$("play"), $("frame"), $("again")]) element.disabled = run.times.length < 2;
  $("rate").value = state.rate;
  $("rate").oninput = () => { state.rate = +$("rate").value; };
  $("color").append(...choices().map(name => make("option", LABELS[name] || name, {value: name})));
  $("map").append(...Object.keys(run.maps).map(name => make("option", name)));
  for (const name of ["color", "map", "grow"]) {
    $(name).value = state[name];
    $(name).oninput = () => { state[name] = name === "grow" ? +$(name).value : $(name).value; recolor(); };
  }
  for (const name of ["box", "walls", "trails", "log", "fit", "dark"]) {
    $(name).checked = state[name];
    $(name).onchange = () => { state[name] = $(name).checked; document.body.classList.toggle("light", !state.dark); recolor(); };
  }
  $("walls").parentElement.hidden = !run.walls.length;
  $("trails").parentElement.hidden = !run.trails;
  $("views").hidden = camera.flat;
  $("reset").onclick = () => view();
  $("above").onclick = () => view(-Math.PI / 2, Math.PI / 2);
  $("front").onclick = () => view(-Math.PI / 2, 0);
  $("side").onclick = () => view(0, 0);
  let from = null, moved = 0;
  canvas.onpointerdown = event => { from = event; moved = 0; canvas.setPointerCapture(event.pointerId); };
  canvas.onpointerup = event => {
    if (from && moved < 4) { pick(event.offsetX, event.offsetY); draw(); }
    from = null;
  };
  canvas.onpointermove = event => {
    if (!from) return;
    const [dx, dy] = [event.clientX - from.clientX, event.clientY - from.clientY];
    moved += Math.abs(dx) + Math.abs(dy);
    if (camera.flat || event.shiftKey || event.buttons === 2) camera.move(dx, dy, canvas.clientHeight);
    else camera.turn(dx * 0.008, dy * 0.008);
    from = event;
    draw();
  };
  canvas.oncontextmenu = event => event.preventDefault();
  canvas.ondblclick = () => view();
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    camera.zoom(Math.exp(0.0012 * event.deltaY));
    draw();
  }, {passive: false});
  addEventListener("keydown", event => {
    if (["SELECT", "INPUT"].includes(event.target.tagName) && event.target.type !== "range" && event.target.type !== "checkbox") return;
    const steps = {ArrowLeft: state.frame - 1, ArrowRight: state.frame + 1, Home: 0, End: run.times.length - 1};
    if (event.key === " ") play(!state.playing);
    else if (event.key in steps) { play(false); show(steps[event.key]); }
    else return;
    event.preventDefault();
  });
  addEventListener("resize", resize);
  addEventListener("message", event => { if (event.data && event.data.block) addFrame(event.data); });
}

function begin() {
  try {
    spheres = new Spheres(canvas);
  } catch (error) {
    $("failed").textContent = `The spheres cannot be drawn: ${error.message}`;
    $("failed").hidden = false;
    return;
  }
  camera = new Camera(Math.hypot(...sides) || 1, run.planar || !(sides[2] > 0));
  camera.reset(sides, canvas.clientWidth / canvas.clientHeight);
  tell();
  listen();
  resize();
  recolor();
  requestAnimationFrame(tick);
  document.body.dataset.ready = "yes";
}

begin();
