// A recorded run: unpacks the numbers of the page, draws the charts and the scene, plays the run.
"use strict";

const run = JSON.parse(document.getElementById("run").textContent);
const by = (id) => document.getElementById(id);

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// Columns by name: the time in double precision, then the others in single; a gap is null.
async function columns({ points, keys, data }) {
  const buffer = await unpacked(data), withGaps = (values) => Array.from(values, (v) => (Number.isFinite(v) ? v : null));
  const found = { time: Array.from(new Float64Array(buffer, 0, points)) };
  keys.forEach((key, n) => { found[key] = withGaps(new Float32Array(buffer, 8 * points + 4 * n * points, points)); });
  return found;
}

const AROUND_S = 0.3, SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];

function player(charts, scene, moving, trace) {
  const { time } = moving, last = time.length - 1, begin = time[0], end = time[last];
  const play = element("button", { textContent: "Play" }), slider = element("input", { type: "range", min: begin, max: end, step: "any", value: begin, ariaLabel: "time" });
  const speed = element("select", { ariaLabel: "speed" }, ...SPEEDS.map((s) => new Option(`× ${s}`, s, s === 1, s === 1)));
  let before = null;
  const show = (t) => { slider.value = t; slider.ariaValueText = `${t.toFixed(2)} s`; if (scene) scene.show(moving, rowAt(time.length, (i) => time[i], t)); if (trace) trace.go(t); };
  const go = (t) => { show(t); charts.at = t; charts.showCursor(); };
  const step = (now) => {
    if (before === null) return;
    const t = Number(slider.value) + (now - before) * 1e-3 * Number(speed.value);
    before = now; go(Math.min(t, end));
    if (t < end) requestAnimationFrame(step); else stop();
  };
  const stop = () => { before = null; play.textContent = "Play"; };
  play.onclick = () => {
    if (before !== null) { stop(); return; }
    if (Number(slider.value) >= end) go(begin);
    play.textContent = "Stop"; before = performance.now(); requestAnimationFrame(step);
  };
  slider.oninput = () => go(Number(slider.value));
  charts.onCursor = (t) => { if (before === null && t !== null) show(t); };
  by("play").append(play, slider, speed);
  go(run.first);
  return go;
}

async function draw() {
  const data = await columns(run), charts = new Charts(by("charts"), by("bar"), { height: run.height });
  charts.shades = run.shades; charts.marks = run.marks; charts.spanGaps = run.span_gaps; charts.list = by("list");
  charts.describe(run.curves, run.charts);
  charts.setData(data);
  let scene = null, moving = data;
  if (run.scene) {
    scene = new Scene(by("scene"));
    scene.describe(run.scene, run.scene.dead);
    moving = await columns(run.scene);
  }
  by("scene").hidden = !scene;
  let go = () => {};
  const trace = run.frames && new Trace(by("trace"), (t) => { charts.mark(t); go(t); });
  if (trace) trace.begin(run.frames.kinds, framesOf(await unpacked(run.frames.data), 0, run.frames.points), run.frames.note);
  if (moving.time.length) go = player(charts, scene, moving, trace);
  by("marks").replaceChildren(...run.marks.slice(0, 200).map(({ time_s, text }) => {
    const button = element("button", { className: "key", textContent: `${time_s.toFixed(3)} s  ${text}` });
    button.onclick = () => { charts.pin = time_s; charts.zoom({ min: time_s - AROUND_S, max: time_s + AROUND_S }); go(time_s); };
    return element("li", {}, button);
  }));
  document.body.dataset.drawn = charts.plots.length;
}

draw().catch((error) => { by("charts").textContent = `The curves cannot be drawn: ${error}`; });
