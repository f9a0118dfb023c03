// Frames one by one: raw bytes beside the values that the database gives them. Data as `decoding.trace`.
"use strict";

const ROW_PX = 20, MOST_LIVE = 60000, BEFORE = 256;
const SIGNS = { "=": (a, b) => a === b, "<": (a, b) => a < b, ">": (a, b) => a > b, "<=": (a, b) => a <= b, ">=": (a, b) => a >= b };
const hex = (bytes) => Array.from(bytes, (b) => b.toString(16).toUpperCase().padStart(2, "0"));

// Frames of a buffer: all times, all kinds, all lengths, all bytes.
function framesOf(buffer, begin, n) {
  const time = new Float64Array(buffer, begin, n), kind = new Uint16Array(buffer, begin + 8 * n, n), length = new Uint8Array(buffer, begin + 10 * n, n);
  let at = begin + 11 * n;
  return Array.from(time, (t, i) => ({ time: t, kind: kind[i], data: new Uint8Array(buffer, (at += length[i]) - length[i], length[i]) }));
}

// The raw value of a signal in the bytes of a frame; null beyond their end.
function rawOf({ first_bit: first, length, motorola, is_signed: signed, is_float: float }, bytes) {
  if (first + length > 8 * bytes.length) return null;
  const ordered = motorola ? bytes : Uint8Array.from(bytes).reverse();
  const whole = BigInt(`0x${hex(ordered).join("")}`), behind = motorola ? 8 * bytes.length - first - length : first;
  const bits = BigInt.asUintN(length, whole >> BigInt(behind));
  if (!float) return signed ? BigInt.asIntN(length, bits) : bits;
  const view = new DataView(new ArrayBuffer(8));
  view.setBigUint64(0, bits << BigInt(64 - length));
  if (length > 16) return length === 32 ? view.getFloat32(0) : view.getFloat64(0);
  const half = view.getUint16(0), exponent = (half >> 10) & 31, fraction = half & 1023, sign = half >> 15 ? -1 : 1;
  return sign * (exponent === 31 ? (fraction ? NaN : Infinity) : exponent ? 2 ** (exponent - 25) * (1024 + fraction) : 2 ** -24 * fraction);
}

// The signals that a frame has, each with its value and, if the database has one, its word.
function valuesOf(signals, bytes) {
  const raw = {}, found = [];
  for (const signal of signals) {
    const { name, under, ids, scale, offset, words, unit } = signal;
    if (under !== null && !(raw[under] !== undefined && ids.includes(Number(raw[under])))) continue;
    const bits = rawOf(signal, bytes);
    if (bits === null) continue;
    raw[name] = bits;
    const whole = typeof bits === "bigint" && Number.isInteger(scale) && Number.isInteger(offset);
    found.push({ name, unit, value: whole ? bits * BigInt(scale) + BigInt(offset) : Number(bits) * scale + offset, word: words[bits] });
  }
  return found;
}

const told = ({ name, unit, value, word }) => `${name} ${word === undefined ? (typeof value === "bigint" ? value : Number(value.toPrecision(6))) : word}${unit && word === undefined ? ` ${unit}` : ""}`;

class Trace {
  // `onTime` gets the time of a clicked frame.
  constructor(place, onTime) {
    Object.assign(this, { place, onTime, at: null, here: -1 });
    this.filter = element("input", { type: "search", placeholder: "120 torque -status DStar>0.5 data=0f00", ariaLabel: "filter of the frames", title: "Each word must occur in bus, identifier or message; -word must not. DStar>0.5 compares a value, Mode=RUN a word, data=0f00 finds bytes." });
    this.count = element("output");
    this.body = element("tbody");
    const heads = ["time in s", "Δ in ms", "bus", "identifier", "message", "bytes", "values"].map((textContent) => element("th", { textContent }));
    this.spacer = element("div", {}, element("table", {}, element("thead", {}, element("tr", {}, ...heads)), this.body));
    this.scroller = element("div", { className: "frames", tabIndex: 0, ariaLabel: "frames" }, this.spacer);
    this.scroller.setAttribute("role", "region");
    place.append(element("div", { className: "bar" }, this.filter, this.count), this.scroller);
    this.filter.oninput = () => this.choose();
    this.scroller.onscroll = () => this.show();
    this.scroller.onkeydown = (event) => {
      const by = { ArrowUp: -1, ArrowDown: 1 }[event.key], next = by && this.chosen[this.here + by];
      if (next) { event.preventDefault(); this.choice(this.here + by); }
    };
    place.addEventListener("toggle", () => this.show());
    this.begin([]);
  }

  begin(kinds, frames = [], note = "") { Object.assign(this, { kinds: [], frames, note }); this.know(kinds); this.choose(); }

  know(kinds) {
    this.kinds.push(...kinds.map((kind) => ({ ...kind, names: kind.signals.map((signal) => signal.name.toLowerCase()), text: `${kind.bus} ${kind.identifier} ${kind.name}`.toLowerCase() })));
  }

  // Add the newest frames, and show them with the next picture of the page.
  take(frames) {
    for (const frame of frames) { this.frames.push(frame); if (this.fits(frame)) this.chosen.push(frame); }
    if (this.frames.length > MOST_LIVE) { this.frames = this.frames.slice(MOST_LIVE / 4); this.choose(); }
    if (!this.due) requestAnimationFrame(() => this.follow());
    this.due = true;
  }

  // Whoever looks at the last row stays at the last row.
  follow() {
    const { scroller } = this, atEnd = scroller.scrollTop + scroller.clientHeight > scroller.scrollHeight - 2 * ROW_PX;
    this.due = false;
    this.size();
    if (atEnd) scroller.scrollTop = scroller.scrollHeight;
    this.show();
  }

  choose() {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean).map((word) => this.test(word));
    this.fits = (frame) => words.every((fits) => fits(frame));
    this.chosen = words.length ? this.frames.filter(this.fits) : [...this.frames];
    this.size();
    if (this.at === null) { this.here = -1; this.scroller.scrollTop = this.scroller.scrollHeight; this.show(); } else this.go(this.at);
  }

  test(word) {
    const not = word.length > 1 && word.startsWith("-"), text = not ? word.slice(1) : word, compared = /^(.+?)(<=|>=|<|>|=)(.+)$/.exec(text);
    let fits = (frame) => this.kinds[frame.kind].text.includes(text);
    if (compared && compared[1] === "data") fits = (frame) => hex(frame.data).join("").toLowerCase().includes(compared[3]);
    else if (compared) {
      const [, name, sign, to] = compared;
      fits = (frame) => this.kinds[frame.kind].names.includes(name) && this.values(frame).some((v) => v.name.toLowerCase() === name && ((sign === "=" && String(v.word).toLowerCase() === to) || SIGNS[sign](Number(v.value), Number(to))));
    }
    return not ? (frame) => !fits(frame) : fits;
  }

  values(frame) { return valuesOf(this.kinds[frame.kind].signals, frame.data); }

  size() {
    this.spacer.style.height = `${(this.chosen.length + 1) * ROW_PX}px`;
    this.count.textContent = `${this.chosen.length} of ${this.frames.length} frames${this.note}`;
  }

  // Show the last frame until a time in the middle of the rows.
  go(time_s) {
    this.at = time_s;
    this.look(rowAt(this.chosen.length, (i) => this.chosen[i].time, time_s));
  }

  look(row) {
    this.here = row;
    this.scroller.scrollTop = (row + 1) * ROW_PX - this.scroller.clientHeight / 2;
    this.show();
  }

  choice(row) { this.onTime(this.chosen[row].time); this.at = this.chosen[row].time; this.look(row); }

  show() {
    if (!this.place.open) return;
    const { scroller, chosen } = this, first = Math.floor(scroller.scrollTop / ROW_PX), rows = Math.max(Math.floor(scroller.clientHeight / ROW_PX) - 1, 1);
    this.body.replaceChildren(...chosen.slice(first, first + rows).map((frame, i) => this.row(frame, first + i)));
  }

  row(frame, at) {
    const { bus, identifier, name } = this.kinds[frame.kind];
    let k = at - 1;
    while (k >= 0 && k > at - BEFORE && this.chosen[k].kind !== frame.kind) k--;
    const since = k >= 0 && this.chosen[k].kind === frame.kind ? (1e3 * (frame.time - this.chosen[k].time)).toFixed(3) : "";
    const values = this.values(frame).map(told).join(", ");
    const cells = [frame.time.toFixed(6), since, bus, identifier, name, hex(frame.data).join(" "), values].map((textContent) => element("td", { textContent, title: textContent }));
    const made = element("tr", { onclick: () => this.choice(at) }, ...cells);
    if (at === this.here) made.setAttribute("aria-current", "true");
    return made;
  }
}
