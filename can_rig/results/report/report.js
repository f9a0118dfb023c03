// The curves of a run: unpacks the numbers of the page and draws a plot for each panel.
"use strict";

const run = JSON.parse(document.getElementById("run").textContent);

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// A gap is null; of a logarithmic axis zero is one as well.
const withGaps = (values) => Array.from(values, (v) => (Number.isFinite(v) ? v : null));

// The time of each fault lies under the curves, with a line where it begins.
function shade(u) {
  const { left, top, width, height } = u.bbox;
  u.ctx.save();
  u.ctx.beginPath();
  u.ctx.rect(left, top, width, height);
  u.ctx.clip();
  for (const { begin, end, color } of run.shades) {
    const from = u.valToPos(begin, "x", true);
    const to = end === null ? left + width : u.valToPos(end, "x", true);
    u.ctx.fillStyle = color;
    u.ctx.fillRect(from, top, to - from, height);
    u.ctx.fillStyle = "#1b1b1b";
    u.ctx.fillRect(from, top, 1, height);
  }
  u.ctx.restore();
}

const FONT = "12px sans-serif";
const HEIGHT = 200;

// Of a logarithmic axis: a line and a number for each decade.
const decades = (u, splits) =>
  splits.map((v) => (v !== null && Math.abs(Math.log10(v) % 1) < 1e-6 ? v : null));
const DECADES = {
  filter: decades,
  grid: { filter: decades },
  ticks: { filter: decades },
  values: (u, splits) => splits.map((v) => (v === null ? "" : v.toExponential(0))),
};

const plots = [];
let moving = false;

// What is zoomed in one plot is zoomed in all.
function follow(u, key) {
  if (key !== "x" || moving) return;
  moving = true;
  const { min, max } = u.scales.x;
  for (const other of plots) if (other !== u) other.setScale("x", { min, max });
  moving = false;
}

function options(panel, width) {
  const label = panel.unit ? `${panel.name} in ${panel.unit}` : panel.name;
  const precise = (u, v) => (v === null || v === undefined ? "–" : v.toPrecision(5));
  return {
    width,
    height: HEIGHT,
    cursor: { sync: { key: "run" }, drag: { x: true, y: false } },
    scales: { x: { time: false }, y: panel.log ? { distr: 3 } : {} },
    axes: [
      { font: FONT },
      { label, size: 80, labelSize: 18, font: FONT, labelFont: FONT, ...(panel.log ? DECADES : {}) },
    ],
    series: [
      { label: "time in s", value: (u, v) => (v === null || v === undefined ? "–" : v.toFixed(6)) },
      ...panel.curves.map((curve) => ({
        label: curve.label,
        stroke: curve.color,
        width: curve.width,
        dash: curve.dash,
        value: precise,
        points: { show: false },
        paths: curve.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
      })),
    ],
    hooks: { drawClear: [shade], setScale: [follow] },
  };
}

async function draw() {
  const buffer = await unpacked(run.data);
  const time = Array.from(new Float64Array(buffer, 0, run.points));
  const place = document.getElementById("plots");
  let at = 8 * run.points;
  for (const panel of run.panels) {
    const columns = panel.curves.map(() => {
      const values = withGaps(new Float32Array(buffer, at, run.points));
      at += 4 * run.points;
      return values;
    });
    plots.push(new uPlot(options(panel, place.clientWidth), [time, ...columns], place));
  }
  addEventListener("resize", () => {
    for (const u of plots) u.setSize({ width: place.clientWidth, height: HEIGHT });
  });
  document.body.dataset.drawn = plots.length;
}

draw().catch((error) => {
  document.getElementById("plots").textContent = `The curves cannot be drawn: ${error}`;
});
