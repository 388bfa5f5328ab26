// Buttons, sliders, keys and mouse; all begins here.

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
  if (!camera.chosen) camera.reset(sides, canvas.width / canvas.height);
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
  if (azimuth !== undefined) [camera.azimuth, camera.elevation, camera.chosen] = [azimuth, elevation, true];
  draw();
}

function addFrames({frames, ranges, curves}) {  // of a simulation that goes on, in a notebook
  for (const {block, time, number} of frames) {
    blocks.push(block);
    run.times.push(time);
    run.numbers.push(number);
  }
  for (const column of run.columns) if (ranges[column.name]) [column.low, column.high] = ranges[column.name];
  run.curves = curves;
  const last = run.times.length - 1;
  $("frame").max = last;
  for (const element of [$("play"), $("frame"), $("again")]) element.disabled = last < 1;
  tellCurves();
  drawBar();
  if (!state.playing) show(last);
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
  $("facts").textContent = run.facts.join(" · ");
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
  addEventListener("message", event => { if (event.data && event.data.frames) addFrames(event.data); });
}

function fail(why) {
  $("failed").textContent = `The spheres cannot be drawn: ${why}`;
  $("failed").hidden = false;
}

function begin() {
  canvas.addEventListener("webglcontextlost", () => fail("the browser has lost its graphics memory; load the page again"));
  try {
    spheres = new Spheres(canvas);
  } catch (error) {
    fail(error.message);
    return;
  }
  camera = new Camera(Math.hypot(...sides) || 1, run.planar || !(sides[2] > 0));
  tell();
  listen();
  resize();
  recolor();
  requestAnimationFrame(tick);
  document.body.dataset.ready = "yes";
}

begin();
