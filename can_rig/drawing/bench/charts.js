// Charts of signals over time, of a live run or a recorded run: one zoom, one cursor, one time axis.
"use strict";

const LEAST_HEIGHT = 60, TIME_AXIS = 30, PARTS = 6, STORED = "can-rig layouts";
const element = (name, more, ...children) => {
  const made = Object.assign(document.createElement(name), more);
  made.append(...children);
  return made;
};
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
// The last of `n` rows until a time; 0 if all rows are later.
const rowAt = (n, timeOf, time_s) => {
  let low = 0, high = n - 1;
  while (low < high) { const middle = (low + high + 1) >> 1; if (timeOf(middle) <= time_s) low = middle; else high = middle - 1; }
  return low;
};
const shown = (v) => (v === null || v === undefined ? "–" : Math.abs(v) >= 1e5 || (v !== 0 && Math.abs(v) < 1e-3) ? v.toExponential(2) : String(Number(v.toPrecision(4))));

class Charts {
  // `place` gets the charts, `bar` the time at the cursor and the list of signals; `fit` fills the
  // height of the place, else each chart has `height` pixels.
  constructor(place, bar, { height = 0, windowS = null } = {}) {
    Object.assign(this, { place, height, windowS, plots: [], data: {}, marks: [], shades: [], range: null, pin: null, at: null });
    this.time = element("output", { textContent: "" });
    this.add = element("select", { ariaLabel: "add a chart" });
    this.add.onchange = () => { this.addChart(this.add.value); this.add.selectedIndex = 0; };
    const whole = element("button", { textContent: "Whole time", title: "show the whole time (double click, or key 0)" });
    whole.onclick = () => this.zoom(null);
    bar.append(this.add, whole, this.layouts(), this.time);
    this.sizes = new ResizeObserver(() => this.resize()); // of the place, and of captions whose values need another line
    this.sizes.observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.remake());
  }

  // Curves and charts of a run, as `Curve` and `Chart` of Python describe them.
  describe(curves, charts) {
    this.curves = Object.fromEntries(curves.map((each) => [each.key, each]));
    this.first = { charts };
    this.charts = this.known(this.first);
    this.add.replaceChildren(new Option("add a chart …", ""), ...this.own().map((c) => new Option(c.label, c.key)));
    [this.range, this.pin, this.at] = [null, null, null];
    this.listed = this.list ? this.showList() : [];
    this.remake();
  }

  // The list of signals: those of a message together; a click adds a chart.
  showList() {
    const groups = new Map(), values = [];
    for (const { key, label } of this.own()) {
      const [group, name] = label.includes(".") ? label.split(/\.(.*)/) : ["signals", label];
      const value = element("output"), button = element("button", { className: "key", title: `add a chart of ${label}` }, name, value);
      button.onclick = () => this.addChart(key);
      if (!groups.has(group)) groups.set(group, element("details", { open: true }, element("summary", { textContent: group })));
      groups.get(group).append(button);
      values.push([key, value]);
    }
    this.list.replaceChildren(...groups.values());
    return values;
  }

  // The curves, but for the curves of a second run, which come with the first run's.
  own() { const others = Object.values(this.curves).map((c) => c.beside); return Object.values(this.curves).filter((c) => !others.includes(c.key)); }

  both(key) { return [key, this.curves[key].beside].filter(Boolean); }

  addChart(key) {
    this.charts.push({ title: this.curves[key].label, keys: this.both(key), scale: "linear", hidden: new Set() });
    this.remake();
  }

  addTo(chart, key) { chart.keys.push(...this.both(key).filter((each) => !chart.keys.includes(each))); this.remake(); }

  // Layouts: which charts, of which signals, how large; in the browser by name, and as a file.
  layout() {
    const own = this.own().map((c) => c.key);
    return { charts: this.charts.map((chart) => ({ ...chart, keys: chart.keys.filter((key) => own.includes(key)), hidden: [...chart.hidden] })) };
  }

  // The charts of a layout whose signals this run has.
  known({ charts }) {
    const some = charts.map((chart) => ({ ...chart, hidden: new Set(chart.hidden), keys: [...new Set(chart.keys.filter((key) => this.curves[key]).flatMap((key) => this.both(key)))] }));
    return some.filter(({ keys, title }) => keys.length && typeof title === "string");
  }

  apply(layout) {
    const missing = layout.charts.flatMap(({ keys }) => keys).filter((key) => !this.curves[key]);
    this.charts = this.known(layout);
    this.remake();
    return missing.length ? `not in this run: ${missing.join(", ")}` : "";
  }

  layouts() {
    const name = element("input", { placeholder: "name", ariaLabel: "name of the layout", size: 12 }), saved = element("span", { className: "saved" }), says = element("span", { role: "status" });
    const file = element("input", { type: "file", accept: ".json", hidden: true, ariaLabel: "file of a layout" }), button = (textContent, onclick, more) => element("button", { textContent, onclick, ...more });
    const stored = () => { try { return JSON.parse(localStorage.getItem(STORED)) || {}; } catch { return {}; } };
    const store = (all) => { try { localStorage.setItem(STORED, JSON.stringify(all)); says.textContent = ""; } catch { says.textContent = "this browser keeps nothing; write a file"; } list(); };
    const use = (layout) => { try { says.textContent = this.apply(layout); } catch { says.textContent = "not a layout of charts"; } };
    const list = () => saved.replaceChildren(...Object.entries(stored()).map(([of, layout]) => element("span", {}, button(of, () => use(layout)), button("×", () => { const all = stored(); delete all[of]; store(all); }, { className: "icon", ariaLabel: `forget the layout ${of}` }))));
    const keep = () => { const of = name.value.trim(); if (of) store({ ...stored(), [of]: this.layout() }); else says.textContent = "a layout needs a name"; };
    const write = () => {
      const url = URL.createObjectURL(new Blob([JSON.stringify(this.layout(), null, 1)], { type: "application/json" }));
      element("a", { href: url, download: `${name.value.trim() || "layout"}.json` }).click();
      setTimeout(() => URL.revokeObjectURL(url), 1000);
    };
    file.onchange = async () => { const text = await file.files[0].text(); file.value = ""; try { use(JSON.parse(text)); } catch { says.textContent = "not a layout of charts"; } };
    list();
    return element("details", { className: "layouts" }, element("summary", { textContent: "Layouts" }),
      element("div", {}, name, button("Save", keep), saved, button("Write a file", write), button("Read a file", () => file.click()), file, button("As at first", () => use(this.first)), says));
  }

  remove(chart) { this.charts = this.charts.filter((each) => each !== chart); this.remake(); }

  toggle(chart, key, button) {
    const shows = chart.hidden.has(key);
    if (shows) chart.hidden.delete(key); else chart.hidden.add(key);
    button.ariaPressed = String(shows);
    this.plots.find((each) => each.chart === chart).plot.setSeries(chart.keys.indexOf(key) + 1, { show: shows });
  }

  // Draw `data`, an array of values for each key and for `time`.
  setData(data) { this.data = data; this.draw(); }

  draw() {
    const time = this.data.time || [];
    const end = time.length ? time[time.length - 1] : 0;
    let { min, max } = this.range || { min: time[0] || 0, max: end };
    if (!this.range && this.windowS) { min = Math.max(0, end - this.windowS); max = Math.max(end, this.windowS); }
    this.moving = true;
    for (const { plot, chart } of this.plots) {
      plot.batch(() => {
        plot.setData([time, ...chart.keys.map((key) => this.data[key] || time.map(() => null))], false);
        plot.setScale("x", { min, max });
      });
    }
    this.moving = false;
    this.showValues();
  }

  zoom(range) { this.range = range; this.draw(); }

  showValues() {
    const time = this.data.time || [], last = time.length - 1;
    const at = this.at === null ? last : this.index(this.at), pin = this.pin === null ? null : this.index(this.pin);
    for (const { chart, values } of this.plots) {
      chart.keys.forEach((key, i) => {
        const v = this.value(key, at), p = pin === null ? null : this.value(key, pin);
        values[i].textContent = this.said(key, v) + (pin === null || v === null || p === null ? "" : ` (Δ ${shown(v - p)})`);
      });
    }
    for (const [key, value] of this.listed) value.textContent = this.said(key, this.value(key, at));
    const t = (s) => `${s.toFixed(3)} s`;
    const here = last < 0 ? "" : this.at === null ? `last values, at ${t(time[last])}` : `values at ${t(time[at])}`;
    this.time.textContent = here + (pin === null || last < 0 ? "" : `, ${t(time[at] - time[pin])} after the mark`);
  }

  // The value of that row; of signals with times of their own, the last one until then.
  value(key, row) {
    const values = this.data[key] || [];
    while (this.spanGaps && row > 0 && values[row] === null) row -= 1;
    return values[row];
  }

  said(key, v) { const { words } = this.curves[key]; return words && words[v] !== undefined ? words[v] : shown(v); }

  index(time_s) { const time = this.data.time || []; return rowAt(time.length, (i) => time[i], time_s); }

  remake() {
    for (const { plot, figure } of this.plots) { plot.destroy(); figure.remove(); this.sizes.unobserve(figure.querySelector("figcaption")); }
    if (!this.charts) return;
    const last = this.rows().at(-1) || [];
    this.plots = this.charts.map((chart) => this.make(chart, last.includes(chart)));
    this.resize();
  }

  // Charts side by side, row by row.
  rows() {
    const rows = [];
    let free = 0;
    for (const chart of this.charts) {
      const width = chart.width || 1;
      if (width > free + 1e-6) { rows.push([]); free = 1; }
      rows.at(-1).push(chart);
      free -= width;
    }
    return rows;
  }

  resize() {
    if (!this.plots.length || !this.place.clientWidth) return;
    for (const { chart, figure } of this.plots) figure.style.width = `${100 * (chart.width || 1)}%`;
    const of = (chart) => this.plots.find((each) => each.chart === chart), sum = (values) => values.reduce((total, v) => total + v, 0);
    const rows = this.rows(), captions = sum(rows.map((row) => Math.max(...row.map((chart) => of(chart).caption.offsetHeight))));
    const given = rows.map((row) => Math.max(...row.map((chart) => chart.height || 0))), free = this.place.clientHeight - TIME_AXIS - captions - sum(given);
    const height = this.height || Math.max(LEAST_HEIGHT, Math.floor(free / Math.max(given.filter((h) => !h).length, 1)));
    rows.forEach((row, r) => row.forEach((chart) => {
      const { plot, figure } = of(chart), low = this.height && this.curves[chart.keys[0]].words ? 0.7 : 1;
      plot.setSize({ width: figure.clientWidth, height: (chart.height || given[r] || low * height) + (r === rows.length - 1 ? TIME_AXIS : 0) });
    }));
    this.draw();
  }

  // The background of a chart: times of faults and states, events with their number.
  shade(u) {
    const { left, top, width, height } = u.bbox, { ctx } = u;
    ctx.save();
    ctx.beginPath(); ctx.rect(left, top, width, height); ctx.clip();
    for (const { begin, end, colour: name } of this.shades) {
      const from = u.valToPos(begin, "x", true), to = end === null ? left + width : u.valToPos(end, "x", true);
      ctx.fillStyle = colour(name);
      ctx.fillRect(from, top, Math.max(to - from, 1), height);
    }
    const lines = [...this.marks.map(({ time_s }) => [time_s, "ink", []]), ...(this.pin === null ? [] : [[this.pin, "blue", [4, 3]]])];
    for (const [time_s, name, dash] of lines) {
      const x = Math.round(u.valToPos(time_s, "x", true));
      ctx.strokeStyle = colour(name); ctx.lineWidth = devicePixelRatio; ctx.setLineDash(dash);
      ctx.beginPath(); ctx.moveTo(x + 0.5, top); ctx.lineTo(x + 0.5, top + height); ctx.stroke();
    }
    ctx.restore();
  }

  caption(chart) {
    const values = [], keys = element("span", { className: "keys" });
    for (const key of chart.keys) {
      const curve = this.curves[key], value = element("output");
      const line = `<svg viewBox="0 0 24 8" aria-hidden="true"><path d="M0 4H24" stroke="var(--${curve.colour})" stroke-width="${1.5 * curve.width}" stroke-dasharray="${curve.dash.join(" ")}"/></svg>`;
      const button = element("button", { className: "key", innerHTML: line, title: "show or hide", ariaPressed: String(!chart.hidden.has(key)) });
      button.append(chart.keys.length > 1 || curve.label !== chart.title ? curve.label.replace(`${chart.title} `, "") : "", value);
      button.onclick = () => this.toggle(chart, key, button);
      keys.append(button); values.push(value);
    }
    const more = element("select", { ariaLabel: `add a signal to ${chart.title}`, className: "icon" }, new Option("+", ""));
    more.append(...this.own().filter((c) => !chart.keys.includes(c.key)).map((c) => new Option(c.label, c.key)));
    more.onchange = () => this.addTo(chart, more.value);
    const close = element("button", { className: "icon", textContent: "×", ariaLabel: `remove the chart ${chart.title}` });
    close.onclick = () => this.remove(chart);
    const { unit } = this.curves[chart.keys[0]];
    const title = element("b", { textContent: chart.title + (unit ? ` in ${unit}` : ""), title: "drag to another place" });
    return { values, title, caption: element("figcaption", {}, title, keys, more, close) };
  }

  // A drag of the title moves a chart, a drag of the corner gives its size.
  arrange(figure, chart, title, corner) {
    const drag = (handle, onMove, onEnd) => {
      handle.onpointerdown = (down) => {
        down.preventDefault(); handle.setPointerCapture(down.pointerId);
        const move = onMove(down);
        handle.onpointermove = move;
        handle.onpointerup = handle.onpointercancel = () => { handle.onpointermove = handle.onpointerup = handle.onpointercancel = null; onEnd(); };
      };
    };
    let target = null;
    const mark = (over, after) => {
      if (target) target.over.classList.remove("before", "after");
      target = over && { over, after };
      if (over) over.classList.add(after ? "after" : "before");
    };
    drag(title, () => ({ clientX, clientY }) => {
      const under = document.elementFromPoint(clientX, clientY), over = under && under.closest(".chart");
      if (!over || over === figure || !this.place.contains(over)) { mark(null); return; }
      const { left, top, width, height } = over.getBoundingClientRect(), beside = width < 0.9 * this.place.clientWidth;
      mark(over, beside ? clientX > left + width / 2 : clientY > top + height / 2);
    }, () => {
      if (!target) return;
      const to = this.plots.find((each) => each.figure === target.over).chart, { after } = target;
      mark(null);
      this.charts = this.charts.filter((each) => each !== chart);
      this.charts.splice(this.charts.indexOf(to) + after, 0, chart);
      this.remake();
    });
    drag(corner, (down) => {
      const height = figure.querySelector(".uplot").offsetHeight - this.axisOf(chart), width = figure.offsetWidth;
      return ({ clientX, clientY }) => this.give(chart, height + clientY - down.clientY, (width + clientX - down.clientX) / this.place.clientWidth);
    }, () => this.remake());
  }

  axisOf(chart) { return this.rows().at(-1).includes(chart) ? TIME_AXIS : 0; }

  give(chart, height, width) {
    chart.height = Math.max(LEAST_HEIGHT, Math.round(height));
    chart.width = Math.min(Math.max(Math.round(width * PARTS), 1), PARTS) / PARTS;
    this.resize();
  }

  // Alt and an arrow key move a chart by a place, shift and an arrow key make it larger or smaller.
  arrangeByKey(figure, chart, event) {
    const by = { ArrowUp: [-1, -20, 0], ArrowLeft: [-1, 0, -1], ArrowDown: [1, 20, 0], ArrowRight: [1, 0, 1] }[event.key];
    if (!by || !(event.altKey || event.shiftKey)) return false;
    const from = this.charts.indexOf(chart), to = from + by[0];
    if (event.altKey && this.charts[to]) [this.charts[from], this.charts[to]] = [this.charts[to], chart];
    if (event.shiftKey) this.give(chart, figure.querySelector(".uplot").offsetHeight - this.axisOf(chart) + by[1], (chart.width || 1) + by[2] / PARTS);
    this.remake();
    this.plots[this.charts.indexOf(chart)].figure.focus();
    return true;
  }

  make(chart, isLast) {
    const { values, title, caption } = this.caption(chart), ink = colour("soft"), rule = colour("rule");
    const figure = element("figure", { className: "chart", tabIndex: 0, ariaLabel: `${chart.title} over time; arrow keys move the cursor, Enter sets the mark, plus and minus zoom, Alt and arrow keys move the chart, Shift and arrow keys resize it` }, caption);
    figure.style.width = `${100 * (chart.width || 1)}%`;
    const corner = element("span", { className: "corner", title: "drag to resize" });
    figure.append(corner);
    this.sizes.observe(caption);
    this.place.append(figure);
    this.arrange(figure, chart, title, corner);
    const grid = { stroke: rule, width: 1 }, font = "12px system-ui, sans-serif";
    const words = this.curves[chart.keys[0]].words;
    const splits = words ? wordAxis(words) : { linear: { values: numbers }, log: DECADES, asinh: ASINH }[chart.scale];
    const plot = new uPlot({
      width: Math.max(figure.clientWidth, 50), height: LEAST_HEIGHT, padding: [6, 24, isLast ? 0 : 6, 0],
      cursor: { sync: { key: "bench" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, bind: { dblclick: () => () => { this.zoom(null); return null; } } },
      scales: { x: { time: false }, y: words ? { range: wordRange(words) } : { linear: { range: wideEnough }, log: { distr: 3, range: or([0.01, 1], uPlot.rangeLog) }, asinh: { distr: 4, asinh: 10, range: or([0, 100], uPlot.rangeAsinh) } }[chart.scale] },
      axes: [
        { stroke: ink, grid, font, size: isLast ? TIME_AXIS : 0, space: room, values: isLast ? (u, ticks) => ticks.map((v) => `${Number(v.toPrecision(10))} s`) : () => [], ticks: { show: isLast, stroke: rule } },
        { stroke: ink, grid, font, size: 78, space: 14, ticks: { stroke: rule }, ...splits },
      ],
      series: [{}, ...chart.keys.map((key) => {
        const { colour: name, width, dash, stepped, sets_scale } = this.curves[key];
        return { stroke: colour(name), width, dash: dash.length ? dash : undefined, points: { show: false }, show: !chart.hidden.has(key), spanGaps: this.spanGaps, auto: sets_scale, paths: stepped ? uPlot.paths.stepped({ align: 1 }) : undefined };
      })],
      hooks: {
        drawClear: [(u) => this.shade(u)],
        setCursor: [(u) => {
          if (this.moving || !u.cursor.event) return;
          this.at = u.cursor.left < 0 ? null : u.posToVal(u.cursor.left, "x");
          if (this.onCursor) this.onCursor(this.at);
          this.showValues();
        }],
        setSelect: [(u) => { // every chart shows the selection; the chart under the hand zooms all
          if (u !== this.dragged || u.select.width < 4) return;
          this.zoom({ min: u.posToVal(u.select.left, "x"), max: u.posToVal(u.select.left + u.select.width, "x") });
          for (const { plot } of this.plots) plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
      },
    }, [[], ...chart.keys.map(() => [])], figure);
    this.wire(figure, plot, chart);
    return { chart, plot, figure, caption, values };
  }

  // Wheel and + - zoom, shift and drag pan, a click or Enter sets the mark, arrow keys move the cursor.
  wire(figure, plot, chart) {
    const { over } = plot;
    const about = (factor, at) => {
      const { min, max } = plot.scales.x;
      this.zoom({ min: at - (at - min) * factor, max: at + (max - at) * factor });
    };
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      const { min, max } = plot.scales.x, by = (max - min) * 0.1 * Math.sign(event.deltaY);
      if (event.shiftKey) this.zoom({ min: min + by, max: max + by });
      else about(event.deltaY > 0 ? 1.25 : 0.8, plot.posToVal(event.offsetX, "x"));
    }, { passive: false });
    let from = null;
    over.addEventListener("mousedown", (event) => {
      from = { x: event.clientX, range: { ...plot.scales.x } };
      this.dragged = plot;
      if (event.shiftKey) event.stopImmediatePropagation();
    }, true);
    over.addEventListener("mousemove", (event) => {
      if (!from || !event.shiftKey || !(event.buttons & 1)) return;
      const { min, max } = from.range, by = ((from.x - event.clientX) / over.clientWidth) * (max - min);
      this.zoom({ min: min + by, max: max + by });
    });
    over.addEventListener("mouseup", (event) => {
      if (from && Math.abs(event.clientX - from.x) < 3) this.mark(plot.posToVal(event.offsetX, "x"));
      from = null;
    });
    figure.addEventListener("keydown", (event) => {
      if (event.target !== figure) return;
      if (this.arrangeByKey(figure, chart, event)) { event.preventDefault(); return; }
      const { min, max } = plot.scales.x, at = this.at === null ? max : this.at, step = (max - min) / 100;
      const keys = {
        ArrowLeft: () => { this.at = Math.max(at - step, min); this.showCursor(); }, ArrowRight: () => { this.at = Math.min(at + step, max); this.showCursor(); },
        Enter: () => this.mark(at), Escape: () => this.mark(null), "+": () => about(0.8, at), "-": () => about(1.25, at), 0: () => this.zoom(null),
      };
      if (keys[event.key]) { event.preventDefault(); keys[event.key](); }
    });
  }

  showCursor() {
    this.moving = true;
    for (const { plot } of this.plots) plot.setCursor({ left: plot.valToPos(this.at, "x"), top: -10 });
    this.moving = false;
    this.showValues();
  }

  mark(time_s) { this.pin = time_s === null || (this.pin !== null && Math.abs(time_s - this.pin) < 1e-9) ? null : time_s; this.draw(); }
}

// Pixels from tick to tick of the time, for all digits of its numbers.
function room(u, axis, least, most, pixels) {
  const digits = Math.max(0, Math.ceil(-Math.log10((50 * (most - least)) / pixels)));
  return Math.max(50, 8 * (most.toFixed(0).length + digits + 3));
}

// The range of values on a scale of powers of ten; `otherwise` without values.
const or = (otherwise, range) => (u, least, most) => (least === null ? otherwise : range(least, most, 10, false));

// A range with room that numbers can label; uPlot's own is empty for values that hardly differ.
function wideEnough(u, least, most) {
  if (least === null || (least === 0 && most === 0)) return [-1, 1];
  const half = 0.55 * Math.max(most === least ? 0.2 * Math.abs(most) : most - least, 1e-5 * Math.max(Math.abs(least), Math.abs(most)), 1e-9), middle = (least + most) / 2;
  return [middle - half, middle + half];
}

const FORMATS = []; // by places; a format takes a tenth of a millisecond to make

// Numbers with all digits in which the ticks differ.
function numbers(u, ticks, axis, space, step) {
  const largest = Math.max(...ticks.map(Math.abs)), places = Math.min(Math.max(Math.ceil(1 - Math.log10(step) - 1e-9), 0), 12);
  const digits = (FORMATS[places] ??= new Intl.NumberFormat("en", { maximumFractionDigits: places }));
  return ticks.map((v) => (v !== 0 && (largest < 1e-3 || largest >= 1e7) ? Number(v.toPrecision(4)).toExponential() : digits.format(v)));
}

// Axes with a number for each decade, and for some values on both sides of zero.
const decades = (u, splits) => {
  const exponents = splits.map((v) => (v === null ? NaN : Math.log10(v))), whole = exponents.filter((e) => Math.abs(e - Math.round(e)) < 1e-6);
  const every = Math.ceil((18 * whole.length * devicePixelRatio) / u.bbox.height) || 1;
  return splits.map((v, i) => (Math.abs(exponents[i] - Math.round(exponents[i])) < 1e-6 && Math.round(exponents[i]) % every === 0 ? v : null));
};
const DECADES = { filter: decades, ticks: { filter: decades, stroke: "#8888" }, grid: { filter: decades }, values: (u, splits) => splits.map((v) => (v === null ? "" : v.toExponential(0))) };
const STEPS = [-1e6, -1e4, -100, 0, 100, 1e4, 1e6, 1e8, 1e10, 1e12];
const ASINH = {
  splits: (u, axis, least, most) => STEPS.filter((v) => v >= least && v <= most), filter: (u, ticks) => ticks,
  values: (u, ticks) => ticks.map((v) => (Math.abs(v) < 1e4 ? v : v.toExponential(0))),
};

const wordRange = (words) => { const codes = Object.keys(words).map(Number); return [Math.min(...codes) - 0.5, Math.max(...codes) + 0.5]; };

// An axis of a state: a word for each code.
function wordAxis(words) {
  const codes = Object.keys(words).map(Number);
  return { splits: (u, axis, least, most) => codes.filter((v) => v >= least && v <= most), values: (u, ticks) => ticks.map((v) => words[v]), filter: (u, ticks) => ticks };
}

// Times of each state of a column of codes: [{begin, end, code}].
// The spans of equal codes; `found` those of the first rows, which are continued.
function spans(time, codes, found = []) {
  const until = found.length ? found[found.length - 1].end : -Infinity;
  let first = time.length;
  while (first > 0 && time[first - 1] > until) first--;
  for (let i = first; i < time.length; i++) {
    if (codes[i] === null) continue;
    const last = found[found.length - 1];
    if (last && last.code === codes[i]) last.end = time[i];
    else found.push({ begin: time[i], end: time[i], code: codes[i] });
  }
  return found;
}
