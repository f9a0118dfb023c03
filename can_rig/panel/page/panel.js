// The page of `can-rig panel`: rows in, curves out; buttons in, orders out.
"use strict";

const WINDOW_S = 20, KEPT_S = 180, MOST_EVENTS = 200;
const $ = (id) => document.getElementById(id);
const charts = new Charts($("charts"), $("bar"), { windowS: WINDOW_S }), scene = new Scene($("scene"));
charts.list = element("div");
$("bar").insertBefore(element("details", { className: "layouts" }, element("summary", { textContent: "Signals" }), charts.list), charts.time);
const trace = new Trace($("trace"), (t) => charts.mark(t));

let hello = null, mayTouch = false, lamps = {}, state = { name: "connecting", says: "", orders: [] }, rows = [], shaded = [], stale = false;

// Curves ---------------------------------------------------------------------------------------

const drawn = () => Object.fromEntries([...hello.columns, "error", "confirm"].map((name, i) => [name, rows[i]]));

function draw() {
  requestAnimationFrame(draw);
  if (!stale || !hello || !rows.length || document.hidden) return;
  stale = false;
  const data = drawn(), shade = { 1: "suspect", 2: "confirmed" };
  shaded = spans(data.time, data.fault_state, shaded);
  charts.shades = shaded.filter(({ code }) => shade[code]).map((span) => ({ ...span, colour: shade[span.code] }));
  if (hello.scene) showScene(data); // before the values: their words would have the canvas measured anew
  charts.setData(data);
}

// The rows of the scene: of a car, those with a position; its lane is its path until the first
// fault, and from then on where the reference leads.
let moved = null;
function showScene(data) {
  const car = hello.scene.kind === "car", names = ["time", "output", "reference", "applied_1", "applied_2", "x", "y", "heading", "steering", "lane_x", "lane_y", "lane_heading"];
  if (!moved) moved = { ...Object.fromEntries(names.map((name) => [name, []])), row: -Infinity };
  let i = data.time.length;
  while (i > 0 && data.time[i - 1] > moved.row) i--;
  for (; i < data.time.length; i++) {
    if (data.applied_1[i] === null || data.output[i] === null || (car && data.x[i] === null)) continue;
    const n = moved.time.length - 1, t = data.time[i];
    for (const name of names.slice(0, 9)) moved[name].push(data[name][i]);
    if (car) {
      const passed = n < 0 ? 0 : t - moved.time[n], begun = scene.dead.some((d) => d.begin <= t) && n >= 0;
      const speed = lamps.speed_mps === null || lamps.speed_mps === undefined ? hello.scene.speed : lamps.speed_mps;
      const heading = begun ? moved.lane_heading[n] + (passed * data.reference[i]) / Math.max(speed, 1) : Math.atan2(moved.y[n + 1] - (n < 5 ? 0 : moved.y[n - 5]), moved.x[n + 1] - (n < 5 ? -1 : moved.x[n - 5]));
      moved.lane_heading.push(heading);
      moved.lane_x.push(begun ? moved.lane_x[n] + passed * speed * Math.cos(heading) : data.x[i]);
      moved.lane_y.push(begun ? moved.lane_y[n] + passed * speed * Math.sin(heading) : data.y[i]);
    }
    moved.row = t;
  }
  if (moved.time.length > 12000) for (const name of names) moved[name] = moved[name].slice(4000);
  if (moved.time.length) scene.show(moved, moved.time.length - 1);
}

function append(buffer) {
  const [n, m] = new Uint32Array(buffer, 0, 2);
  if (m === 0) { trace.take(framesOf(buffer, 8, n)); return; }
  const values = new Float64Array(buffer, 8);
  if (m !== hello.columns.length) return;
  if (!rows.length) rows = [...hello.columns, "error", "confirm"].map(() => []);
  for (let c = 0; c < m; c++) {
    const to = rows[c];
    for (let i = 0; i < n; i++) { const v = values[c * n + i]; to.push(Number.isNaN(v) ? null : v); }
  }
  const [reference, output] = ["reference", "output"].map((name) => rows[hello.columns.indexOf(name)]);
  for (let i = rows[m].length; i < rows[0].length; i++) { // two columns that the page computes
    rows[m].push(reference[i] === null || output[i] === null ? null : reference[i] - output[i]); rows[m + 1].push(hello.confirm);
  }
  const time = rows[0], oldest = time[time.length - 1] - KEPT_S;
  if (time[0] < oldest - 10) {
    const drop = time.findIndex((t) => t >= oldest);
    rows = rows.map((values) => values.slice(drop)); shaded = [];
  }
  stale = true;
}

// State and lamps ------------------------------------------------------------------------------

const EMPTY = Object.fromEntries([...document.querySelectorAll(".lamp")].map((el) => [el.id, el.textContent]));
const GOOD = ["running", "finishing"], WARN = ["silent", "failed", "bus-down", "gone"];

function lamp(id, text, state) { const el = $(id); el.textContent = text; el.className = `lamp ${state || ""}`; }

function showState() {
  const now = $("state");
  if (now.textContent !== state.says) now.textContent = state.says;
  now.className = GOOD.includes(state.name) ? "good" : WARN.includes(state.name) ? "warn" : "";
  document.body.dataset.state = state.name;
  for (const el of document.querySelectorAll("[data-order]")) el.disabled = !mayTouch || !state.orders.includes(el.dataset.order);
  $("value").disabled ||= $("value-name").textContent === "no value";
  $("pause").textContent = state.name === "paused" ? "Go on" : "Pause";
  if (state.name === "paused") $("pause").disabled = !mayTouch || !state.orders.includes("pace");
  $("why").textContent = hello && !mayTouch ? "This address may look only." : "";
}

function showLamps() {
  const l = lamps, heard = !["ready", "waiting", "starting", "gone"].includes(state.name), live = ["running", "paused"].includes(state.name);
  if (!heard) { document.querySelectorAll(".lamp").forEach((el) => { el.className = "lamp off"; if (state.name !== "gone") el.textContent = EMPTY[el.id]; }); return; }
  const colour = (kind) => (live ? kind : "off"); // a state that is over is no news
  lamp("mode", `mode ${l.mode || "–"}`, l.mode ? colour(l.mode === "RUN" ? "good" : "warn") : "off");
  const fault = { CLEAR: ["no fault", "good"], SUSPECTED: ["loss suspected", "warn"], CONFIRMED: ["loss confirmed", "warn"] }[l.fault_state];
  lamp("fault_state", fault ? fault[0] : l.fault_state ? l.fault_state.toLowerCase() : "fault –", colour(fault ? fault[1] : "off"));
  const none = !l.verdict || l.verdict.startsWith("no fault");
  lamp("verdict", `verdict: ${l.verdict || "–"}`, colour(!l.verdict ? "off" : none ? "good" : "warn"));
  lamp("nodes", l.silent.length ? `${l.silent.join(" and ")} silent` : "both nodes heard", state.name === "silent" ? "warn" : l.silent.length ? "off" : "good");
  lamp("unanswered", `${l.unanswered_ticks} ticks without commands`, l.unanswered_ticks ? "warn" : "");
  $("unheard").hidden = !l.unheard_ticks; lamp("unheard", `${l.unheard_ticks} ticks not heard`, "");
  lamp("load", l.bus_load === null ? "bus load –" : `bus load ${(100 * l.bus_load).toFixed(1)} %`, l.bus_load > 0.9 ? colour("warn") : "");
  $("speed").hidden = l.speed_mps === null;
  if (l.speed_mps !== null) lamp("speed", `speed ${l.speed_mps.toFixed(1)} m/s`, "");
  const sensors = Object.entries(l.sensors).map(([name, value]) => `${name} ${value === null ? "not valid" : value.toPrecision(3)}`);
  $("sensors").hidden = !sensors.length; lamp("sensors", sensors.join(", "), "");
  lamp("rate", `${l.time_s.toFixed(1)} s${live && state.name === "running" ? `, ${(l.ticks_per_s * hello.tick_s).toFixed(2)} × real time` : ""}`, "");
}

function addEvent(event) {
  const of = hello.places.find((each) => each.place === event.place), kind = of && of.kinds.find((each) => each.kind === event.kind);
  const parts = [of && of.words, kind ? kind.words : event.kind, typeof event.value === "number" && (kind && kind.value ? `${kind.value.split(/[ ,]/)[0]} ` : "") + shown(event.value), event.duration_s && `for ${shown(event.duration_s)} s`];
  const words = parts.filter(Boolean).join(" ");
  const item = element("li", { textContent: `${event.time_s.toFixed(3)} s  ${event.text || `${event.action.toLowerCase().replace("_", " ")} ${words}`}` });
  item.dataset.time = event.time_s; // a change of the state comes later than a command of its time
  let next = null;
  for (let last = $("events").lastElementChild; last && Number(last.dataset.time) > event.time_s; last = last.previousElementSibling) next = last;
  $("events").insertBefore(item, next); $("events").scrollTop = 1e6;
  if ($("events").childElementCount > MOST_EVENTS) $("events").firstElementChild.remove();
  if (event.action === "INJECT") scene.dead.push({ place: event.place, begin: event.time_s, end: event.duration_s ? event.time_s + event.duration_s : null, words });
  if (event.action === "CLEAR") scene.dead.forEach((d) => { if (["all", d.place].includes(event.place) && (d.end === null || d.end > event.time_s)) d.end = event.time_s; });
  if (["MOVE_REFERENCE", "PACE", "PAUSE", "STEP"].includes(event.action)) return;
  charts.marks.push(event);
  if (charts.marks.length > MOST_EVENTS) charts.marks.shift();
}

// Orders ---------------------------------------------------------------------------------------

let socket = null;
function order(name, more) {
  $("message").textContent = "";
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ order: name, ...more }));
}
const number = (id) => ($(id).value === "" ? null : Number($(id).value));
const inject = (kind, place, value) => order("inject", { kind, place, value: value ?? null, for_s: number("for") });

function fill(select, options) { select.replaceChildren(...options.map(([value, words]) => new Option(words, value))); }

const place = () => hello.places.find((each) => each.place === $("place").value);
const kind = () => place().kinds[$("kind").selectedIndex];
function showKinds() { fill($("kind"), place().kinds.map((each) => [each.kind, each.words])); showValue(); }
function showValue() {
  const words = kind().value;
  $("value-name").textContent = words || "no value"; $("value").value = ""; $("value").placeholder = place().place === "world" ? "a number" : "default"; showState();
}
function showMoved() {
  const value = Number($("move").value);
  $("moved").textContent = `${value >= 0 ? "+" : "−"}${Math.abs(value)} ${hello.output.unit}`;
  $("move").setAttribute("aria-valuetext", $("moved").textContent);
}

function wire() {
  $("trace").ontoggle = showFrames;
  $("start").onclick = () => order("start");
  $("stop").onclick = () => order("stop");
  $("scenario").onchange = () => order("choose", { scenario: $("scenario").value });
  $("pause").onclick = () => (lamps.paused ? order("pace", { value: lamps.pace || 1 }) : order("pause"));
  $("step").onclick = () => order("step", { ticks: 1 });
  $("slower").onclick = () => order("pace", { value: Math.max(0.01, (lamps.pace || 1) / 2) });
  $("faster").onclick = () => order("pace", { value: Math.min(64, (lamps.pace || 1) * 2) });
  $("move").oninput = showMoved;
  $("move").onchange = () => order("reference", { value: Number($("move").value) });
  $("place").onchange = showKinds;
  $("kind").onchange = showValue;
  $("inject").onclick = () => inject(kind().kind, $("place").value, kind().number ?? number("value"));
  $("clear").onclick = () => order("clear", { place: "all" });
  $("save").onclick = () => order("save", { name: $("save-name").value || "my-scenario" });
}

function begin(said) {
  hello = said; rows = []; shaded = []; stale = true; lamps = { ...lamps, silent: [] };
  charts.marks = [];
  document.title = `can-rig ${hello.name}`;
  $("name").textContent = hello.name;
  fill($("scenario"), hello.scenarios.map((name) => [name, name])); $("scenario").value = hello.name;
  fill($("place"), hello.places.map((each) => [each.place, each.words])); showKinds();
  $("quick").replaceChildren(...hello.quick.map(({ words, kind, place, value }) => {
    const button = element("button", { className: "fault", textContent: words[0].toUpperCase() + words.slice(1) });
    button.dataset.order = "inject"; button.onclick = () => inject(kind, place, value);
    return button;
  }));
  Object.assign($("move"), { min: -hello.moved_by, max: hello.moved_by, step: hello.moved_by / 40, value: 0 }); showMoved();
  scene.describe(hello.scene, hello.dead); moved = null;
  $("events").replaceChildren(); hello.events.forEach(addEvent);
  for (const id of ["scenario", "start", "stop"]) $(id).hidden = !hello.scenarios.length;
  charts.describe(hello.curves, hello.charts);
  charts.setData({ time: [] });
}

const showFrames = () => order("trace", { on: $("trace").open });

function take(said) {
  if (said.hello) { trace.begin([]); begin(said.hello); }
  if (said.may_touch !== undefined) { mayTouch = said.may_touch; showFrames(); }
  if (said.frames) trace.begin([]);
  if (said.kinds) trace.know(said.kinds);
  if (said.lamps) { lamps = said.lamps; state = said.state; showState(); showLamps(); }
  if (said.events) said.events.forEach(addEvent);
  if (said.refused) $("message").textContent = said.refused;
  if (said.saved) $("message").textContent = `saved as ${said.saved}`;
}

function connect() {
  socket = new WebSocket(`ws://${location.host}${location.pathname}socket`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? take(JSON.parse(data)) : hello && append(data));
  socket.onclose = () => {
    if (state.name !== "gone") {
      const since = new Date().toLocaleTimeString();
      state = { name: "gone", says: `The panel's program is gone since ${since}: nothing here is news. A new can-rig panel has a new address.`, orders: [] };
      showState(); showLamps();
    }
    setTimeout(connect, 1000);
  };
}

wire();
showState();
connect();
requestAnimationFrame(draw);
