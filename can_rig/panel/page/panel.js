// The page of `can-rig panel`: rows in, curves out; buttons in, orders out.
"use strict";

const WINDOW_S = 20, KEPT_S = 180;
const COLOURS = { ink: "#6b675f", blue: "#2a78b8", orange: "#cf5a22", green: "#3a9560", pale: "#e3b49c", violet: "#7a5bb0", gold: "#b58a1b", pink: "#c2508c", grey: "#9a958c" };
const HYPOTHESES = ["orange", "gold", "violet", "blue", "green", "pink", "grey"];
const $ = (id) => document.getElementById(id);

let hello = null, mayTouch = false, lamps = {}, rows = [], charts = [], stale = false;

// Curves ---------------------------------------------------------------------------------------

const PANELS = [
  { of: 0, title: (s) => s.name, curves: [["reference", "ink", [5, 4]], ["output", "blue"]] },
  { of: 0, title: () => "error", curves: [["error", "blue"]] },
  { of: 1, title: (s) => s.name, curves: [["command_1", "pale", null, "commanded"], ["applied_1", "orange", null, "applied"]] },
  { of: 2, title: (s) => s.name, curves: [["command_2", "pale", null, "commanded"], ["applied_2", "orange", null, "applied"]] },
  { of: 0, title: () => "fault estimate", curves: [["estimate", "green"]] },
  { title: () => "evidence of each fault (log-likelihood ratio)", curves: null, height: 170,
    y: { distr: 4, asinh: 10 }, splits: [-1e3, -100, -10, 0, 10, 100, 1e3, 1e4, 1e6, 1e8, 1e10, 1e12] },
];

function evidenceCurves() {
  const each = hello.hypotheses.map(([name, words], i) => [name, HYPOTHESES[i], null, words]);
  return [...each, ["confirm", "ink", [5, 4], "confirms a loss"]];
}

function column(name) {
  if (name === "error") {
    const r = column("reference"), y = column("output");
    return r.map((v, i) => (v === null || y[i] === null ? null : v - y[i]));
  }
  if (name === "confirm") return rows[0].map(() => hello.confirm);
  return rows[hello.columns.indexOf(name)];
}

function stateShade(u) { // where the decision suspects or has confirmed a loss
  const time = rows[0], state = rows[hello.columns.indexOf("fault_state")];
  if (!time || !time.length) return;
  const { ctx } = u, { left, top, width, height } = u.bbox;
  ctx.save();
  ctx.beginPath(); ctx.rect(left, top, width, height); ctx.clip();
  for (const [code, colour] of [[1, "#e9b44c33"], [2, "#b8461a2e"]]) {
    ctx.fillStyle = colour;
    for (let i = 0; i < time.length; i++) {
      if (state[i] !== code) continue;
      let j = i;
      while (j + 1 < time.length && state[j + 1] === code) j++;
      const a = u.valToPos(time[i], "x", true), b = u.valToPos(time[Math.min(j + 1, time.length - 1)], "x", true);
      ctx.fillRect(a, top, Math.max(b - a, 1), height);
      i = j;
    }
  }
  ctx.restore();
}

function shownSplits(splits) { // of a scale that is none of uPlot's own
  if (!splits) return {};
  return { splits: (u, axis, least, most) => splits.filter((v) => v >= least && v <= most), values: (u, ticks) => ticks.map((v) => (Math.abs(v) < 1e4 ? v : v.toExponential(0))), filter: (u, ticks) => ticks };
}

function size(panel) { return { width: $("charts").clientWidth, height: panel.height || Math.max(90, (window.innerHeight - 330) / (PANELS.length - 1) - 40) }; }

function makeCharts() {
  for (const { plot } of charts) plot.destroy();
  const ink = getComputedStyle(document.body).color, grid = { stroke: "#88888833", width: 1 };
  charts = PANELS.map((panel) => {
    const signal = hello.signals[panel.of], unit = signal && signal.unit ? ` in ${signal.unit}` : "";
    const last = panel === PANELS[PANELS.length - 1];
    if (last) panel.curves = evidenceCurves();
    const plot = new uPlot({
      ...size(panel), title: panel.title(signal) + unit, cursor: { sync: { key: "time" }, drag: { x: true, y: false } },
      legend: { show: panel.curves.length > 1, live: !panel.y }, scales: { x: { time: false }, y: panel.y || {} }, hooks: { drawClear: [stateShade] },
      axes: [{ stroke: ink, grid, label: last ? "time in s" : undefined, labelSize: 18, size: last ? 30 : 8, values: last ? undefined : (u, ticks) => ticks.map(() => "") }, { stroke: ink, grid, size: 64, space: 22, ...shownSplits(panel.splits) }],
      series: [{ label: "t" }, ...panel.curves.map(([name, colour, dash, label]) => ({
        label: label || (name === "output" ? signal.name : name), stroke: COLOURS[colour],
        width: name.startsWith("command") ? 2.5 : 1.4, dash: dash || undefined, spanGaps: false, points: { show: false } }))],
    }, [[], ...panel.curves.map(() => [])], $("charts"));
    return { panel, plot };
  });
}

let zoomed = false;
function draw() {
  requestAnimationFrame(draw);
  if (!stale || !hello || !rows.length || document.hidden) return;
  stale = false;
  const time = rows[0], end = time.length ? time[time.length - 1] : 0;
  for (const { panel, plot } of charts) {
    plot.batch(() => {
      plot.setData([time, ...panel.curves.map(([name]) => column(name))], false);
      if (!zoomed) plot.setScale("x", { min: Math.max(0, end - WINDOW_S), max: Math.max(end, WINDOW_S) });
      else plot.redraw();
    });
  }
}

function append(buffer) {
  const [n, m] = new Uint32Array(buffer, 0, 2), values = new Float64Array(buffer, 8);
  if (m !== hello.columns.length) return;
  if (!rows.length) rows = hello.columns.map(() => []);
  for (let c = 0; c < m; c++) {
    const to = rows[c];
    for (let i = 0; i < n; i++) { const v = values[c * n + i]; to.push(Number.isNaN(v) ? null : v); }
  }
  const time = rows[0], oldest = time[time.length - 1] - KEPT_S;
  if (time[0] < oldest - 10) {
    const drop = time.findIndex((t) => t >= oldest);
    rows = rows.map((values) => values.slice(drop));
  }
  stale = true;
}

// Lamps ----------------------------------------------------------------------------------------

function lamp(id, text, state) { const el = $(id); el.textContent = text; el.className = `lamp ${state || ""}`; }

function showLamps(run) {
  const l = lamps, on = run.running || l.ticks_per_s > 1;
  lamp("running", run.running ? (l.paused ? "paused" : "running") : on ? "nodes run" : "no run", on ? "good" : "off");
  lamp("mode", `mode ${l.mode || "–"}`, l.mode === "RUN" ? "good" : l.mode ? "warn" : "off");
  const state = (l.fault_state || "").replace("_", " ").toLowerCase();
  lamp("fault_state", state === "confirmed" ? "loss confirmed" : state === "suspected" ? "loss suspected" : state === "clear" ? "no fault" : state || "channel 1",
    { confirmed: "warn", suspected: "warn", clear: "good" }[state] || "off");
  const none = !l.verdict || l.verdict.startsWith("no fault");
  lamp("verdict", none ? l.verdict || "whose fault" : `verdict: ${l.verdict}`, !l.verdict ? "off" : none ? "good" : "warn");
  lamp("silent", l.silent.length && on ? `${l.silent.join(", ")} silent` : on ? "both nodes heard" : "no nodes", l.silent.length && on ? "warn" : on ? "good" : "off");
  lamp("unanswered", `${l.unanswered_ticks} ticks without commands`, l.unanswered_ticks ? "warn" : "");
  lamp("load", l.bus_load === null ? "bus load –" : `bus load ${(100 * l.bus_load).toFixed(0)} %`, l.bus_load > 0.9 ? "warn" : "");
  $("speed").hidden = l.speed_mps === null;
  if (l.speed_mps !== null) lamp("speed", `${l.speed_mps.toFixed(1)} m/s`, "");
  const sensors = Object.entries(l.sensors).map(([name, value]) => `${name} ${value === null ? "not valid" : value.toPrecision(3)}`);
  $("sensors").hidden = !sensors.length; lamp("sensors", sensors.join(", "), "");
  lamp("rate", `${l.time_s.toFixed(1)} s, ${(l.ticks_per_s * hello.tick_s).toFixed(2)} × real time`, "");
  $("pace").textContent = !l.injectable ? "the plant node obeys no commands" : l.paused ? "paused" : l.pace ? `held to ${l.pace} × real time` : "as fast as it can";
  $("pause").textContent = l.paused ? "Go on" : "Pause";
  $("folder").textContent = run.folder ? `run folder ${run.folder}` : "";
  if (run.said.length && !run.running) $("message").textContent = run.said[run.said.length - 1];
  $("start").disabled = run.running; $("stop").disabled = !run.running; $("scenario").disabled = run.running;
  for (const id of ["faults", "reference"]) $(id).disabled = !mayTouch || !l.injectable;
  for (const id of ["pause", "slower", "faster"]) $(id).disabled = !l.injectable;
  $("step").disabled = !l.injectable || !l.paused;
}

function addEvent(event) {
  const item = document.createElement("li"), parts = [event.kind, event.place === "all" ? "" : event.place, event.value, event.duration_s && `for ${event.duration_s} s`];
  item.textContent = `${event.time_s.toFixed(2)} s  ${event.action.toLowerCase().replace("_", " ")} ${parts.filter((p) => p !== null && p !== undefined && p !== "").join(" ")}`;
  $("events").append(item); item.scrollIntoView({ block: "nearest" });
}

// Orders ---------------------------------------------------------------------------------------

let socket = null;
function order(name, more) {
  $("message").textContent = "";
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ order: name, ...more }));
}
const number = (id) => ($(id).value === "" ? null : Number($(id).value));
const inject = (kind, place, value) => order("inject", { kind, place, value: value ?? null, for_s: number("for") });

function fill(select, words) { select.replaceChildren(...words.map((word) => new Option(word, word))); }

function kindsFor(place) {
  const own = place === "sensor" ? "sensor-" : "actuator-";
  return hello.kinds.filter((kind) => kind.startsWith(own) || kind.startsWith("frames-"));
}

function wire() {
  $("start").onclick = () => order("start");
  $("stop").onclick = () => order("stop");
  $("scenario").onchange = () => order("choose", { scenario: $("scenario").value });
  $("pause").onclick = () => (lamps.paused ? order("pace", { value: lamps.pace || 1 }) : order("pause"));
  $("step").onclick = () => order("step", { ticks: 1 });
  $("slower").onclick = () => order("pace", { value: Math.max(0.01, (lamps.pace || 1) / 2) });
  $("faster").onclick = () => order("pace", { value: Math.min(64, (lamps.pace || 1) * 2) });
  $("move").oninput = () => { $("moved").textContent = (Number($("move").value) >= 0 ? "+" : "") + Number($("move").value).toFixed(2); };
  $("move").onchange = () => order("reference", { value: Number($("move").value) });
  $("motor-dead").onclick = () => inject("actuator-dead", "torque", 0);
  $("half").onclick = () => inject("actuator-dead", "torque", 0.5);
  $("force-dead").onclick = () => inject("actuator-dead", "force-difference", 0);
  $("biased").onclick = () => inject("sensor-biased", "sensor");
  $("place").onchange = () => fill($("kind"), kindsFor($("place").value));
  $("inject").onclick = () => inject($("kind").value, $("place").value, number("value"));
  $("clear").onclick = () => order("clear", { place: "all" });
  $("save").onclick = () => order("save", { name: $("save-name").value || "my-scenario" });
  window.onresize = () => charts.forEach(({ panel, plot }) => plot.setSize(size(panel)));
  $("charts").ondblclick = () => { zoomed = false; stale = true; };
  $("charts").addEventListener("mouseup", () => setTimeout(() => { // a drag zooms until a double click
    zoomed = charts.some(({ plot }) => plot.select.width > 0) || zoomed; }), 0);
}

function take(said) {
  if (said.may_touch !== undefined) mayTouch = said.may_touch;
  if (said.hello) {
    hello = said.hello; rows = []; stale = true;
    $("name").textContent = hello.name;
    fill($("scenario"), hello.scenarios); $("scenario").value = hello.name;
    fill($("place"), hello.places); fill($("kind"), kindsFor($("place").value));
    $("events").replaceChildren(); hello.events.forEach(addEvent);
    $("run").disabled = $("keep").disabled = !mayTouch;
    for (const id of ["scenario", "start", "stop"]) $(id).hidden = !hello.scenarios.length;
    makeCharts();
  }
  if (said.lamps) { lamps = said.lamps; showLamps(said.run); }
  if (said.event) addEvent(said.event);
  if (said.refused) $("message").textContent = said.refused;
  if (said.saved) $("message").textContent = `saved as ${said.saved}`;
}

function connect() {
  socket = new WebSocket(`ws://${location.host}${location.pathname}socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => lamp("connection", "connected", "good");
  socket.onmessage = ({ data }) => (typeof data === "string" ? take(JSON.parse(data)) : hello && append(data));
  socket.onclose = () => {
    document.querySelectorAll(".lamp").forEach((el) => { el.className = "lamp off"; }); // what they say is over
    lamp("connection", "panel gone", "warn"); setTimeout(connect, 1000);
  };
}

wire();
connect();
requestAnimationFrame(draw);
