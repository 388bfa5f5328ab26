// The curves of the diagnostics, with a line at the time that is shown.

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
  const [low, high] = widened(Math.min(...all), Math.max(...all));
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
