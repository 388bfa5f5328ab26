// The picture: spheres, box, walls and trails of the frame that is shown, the bar of its colours, and who was clicked on.

const canvas = $("canvas"), over = $("over").getContext("2d");
let spheres, camera;

function range() {
  let {low, high} = columnOf(state.color);
  if (state.fit) [low, high] = numbers(frameAt(state.frame), state.color).filter(isFinite).reduce(([a, b], x) => [Math.min(a, x), Math.max(b, x)], [Infinity, -Infinity]);
  if (state.log) {
    if (!(high > 0)) high = 1;
    low = Math.max(low, high * 1e-6);
  }
  return state.log && high > low ? [low, high] : widened(low, high);
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
        const dashed = !run.box.real || others.every(k => run.periodic[k] || run.box.upper[k] === run.box.lower[k]) && others.some(k => run.periodic[k]);
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

const times = (m, [x, y, z, w]) => [0, 1, 2, 3].map(r => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r] * w);

// Place of a point on the canvas, and its distance; null behind the viewer.
function project(point, {view, projection} = camera.matrices(canvas.width / canvas.height)) {
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
  const matrices = camera.matrices(canvas.width / canvas.height);
  let best = null;
  for (let i = 0; i < frame.count; i++) {
    const seen = project([at[3 * i], at[3 * i + 1], at[3 * i + 2]], matrices);
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
