// The plant in motion: a car on its road from above, an angle, a position. Data as `results.motion`.
"use strict";

const LANE_M = 3.5, BEHIND_M = 14, AHEAD_M = 36, STEERING_SHOWN = 5, TEXT_WIDTH = 335;

const degrees = (angle) => (Math.round((18000 / Math.PI) * angle) / 100 + 0).toFixed(2);

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.dead = []; this.setting = null; this.data = null;
    canvas.setAttribute("role", "img");
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  describe(setting, dead) {
    this.setting = setting; this.dead = dead; this.data = null;
    this.canvas.hidden = !setting;
    this.draw();
  }

  // Draw the row `i` of `data`, arrays by name.
  show(data, i) { this.data = data; this.row = i; this.draw(); }

  draw() {
    const { canvas, setting, data } = this, ratio = devicePixelRatio;
    if (!setting || !canvas.clientWidth) return;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const ctx = (this.ctx = canvas.getContext("2d")), margin = width > 600 && height < 220 ? TEXT_WIDTH : 0;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height);
    ctx.font = "12px system-ui, sans-serif"; ctx.lineJoin = ctx.lineCap = "round";
    ctx.save(); ctx.beginPath(); ctx.rect(margin, 0, width - margin, height); ctx.clip(); ctx.translate(margin, 0);
    this.width = width - margin;
    this.middle = height * (margin ? 0.5 : width < 600 ? 0.74 : 0.56); // of the lane; the words stand above or beside
    const i = this.row, now = data && data.time.length ? data.time[i] : null;
    this.broken = now === null ? [] : this.dead.filter((d) => d.begin <= now && (d.end === null || now < d.end));
    const words = now === null ? ["no motion yet"] : this[setting.kind].call(this, this.width, height, i);
    ctx.restore();
    if (now !== null) words.unshift(`${now.toFixed(2)} s`);
    const lines = [...words, ...this.broken.map((d) => [`✗ ${d.words}`, "warn"])].map((each) => [each, "ink"].flat());
    lines.forEach(([text, name], row) => { ctx.fillStyle = colour(name); ctx.fillText(text, 8, 16 + 16 * row); });
    canvas.ariaLabel = lines.map(([text]) => text).join(", ");
  }

  fails(place) { return this.broken.some((d) => d.place === place); }

  line(points, name, width, dash = []) {
    const { ctx } = this;
    ctx.strokeStyle = colour(name); ctx.lineWidth = width; ctx.setLineDash(dash);
    ctx.beginPath(); points.forEach(([x, y], n) => (n ? ctx.lineTo(x, y) : ctx.moveTo(x, y))); ctx.stroke();
    ctx.setLineDash([]);
  }

  arrow(x, y, dx, dy, name) {
    const size = Math.hypot(dx, dy);
    if (size < 1) return;
    const [ex, ey] = [dx / size, dy / size], tip = Math.min(size, 7), { ctx } = this;
    this.line([[x, y], [x + dx, y + dy]], name, 3);
    ctx.fillStyle = colour(name); ctx.beginPath(); ctx.moveTo(x + dx + ex * tip, y + dy + ey * tip);
    ctx.lineTo(x + dx - ey * 5, y + dy + ex * 5); ctx.lineTo(x + dx + ey * 5, y + dy - ex * 5); ctx.fill();
  }

  // The camera keeps the lane level; the car moves in the lane.
  car(width, height, i) {
    const { data, setting } = this, lane = data.lane_x ? "lane_" : "";
    const scale = Math.min(width / (BEHIND_M + AHEAD_M), height / 8);
    const [cx, cy, turn] = ["x", "y", "heading"].map((name) => data[lane + name][i]);
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    const place = (x, y) => { const [dx, dy] = [x - cx, y - cy]; return [(width * BEHIND_M) / (BEHIND_M + AHEAD_M) + scale * (dx * cos + dy * sin), this.middle - scale * (dy * cos - dx * sin)]; };
    const way = (prefix, until) => {
      const xs = data[`${prefix}x`], ys = data[`${prefix}y`], points = [];
      const add = (p) => { const q = points[points.length - 1]; if (!q || Math.abs(p[0] - q[0]) + Math.abs(p[1] - q[1]) > 1) points.push(p); }; // a pixel apart
      for (let k = i; k >= 0; k--) { const p = place(xs[k], ys[k]); add(p); if (p[0] < -50) break; }
      points.reverse();
      for (let k = i + 1; k < Math.min(xs.length, until); k++) { const p = place(xs[k], ys[k]); add(p); if (p[0] > width + 50 || p[0] < -50) break; }
      return points;
    };
    const road = way(lane, Infinity), n = road.length;
    if (n > 5) { // beyond the last row: straight on
      const [[ax, ay], [bx, by]] = [road[n - 5], road[n - 1]], size = Math.hypot(bx - ax, by - ay);
      if (size > 0.1) road.push([bx + ((bx - ax) / size) * 2 * width, by + ((by - ay) / size) * 2 * width]);
    }
    this.line(road, "rule", (LANE_M + 0.3) * scale); this.line(road, "asphalt", LANE_M * scale); this.line(road, "soft", 1, [10, 12]);
    const words = [];
    if (data.other_x) {
      this.line(way("other_", i + 1), "orange", 2, [6, 4]);
      this.body(place(data.other_x[i], data.other_y[i]), data.other_heading[i] - turn, scale, null);
      if (lane) words.push([`${setting.other} ${this.off(i, "other_").toFixed(2)} m off the lane's middle`, "orange"]);
    }
    this.line(way("", i + 1), "blue", 2.5);
    this.body(place(data.x[i], data.y[i]), data.heading[i] - turn, scale, i);
    if (lane) words.unshift([`car ${this.off(i, "").toFixed(2)} m off the lane's middle`, "blue"]);
    words.push(`steering angle ${degrees(data.steering[i])}° (drawn × ${STEERING_SHOWN})`, `rear wheels ${shown(Math.round(10 * data.applied_2[i]) / 10)} ${setting.units[2]}`);
    return words;
  }

  off(i, prefix) {
    const { data } = this, turn = data.lane_heading[i];
    return Math.abs((data[`${prefix}y`][i] - data.lane_y[i]) * Math.cos(turn) - (data[`${prefix}x`][i] - data.lane_x[i]) * Math.sin(turn));
  }

  // The car at a place of the screen; without a row, an outline; beyond the screen, an arrow.
  body([x, y], turn, scale, i) {
    const { ctx, data, setting } = this, [front, rear, track] = setting.sizes, inside = (v, most) => Math.min(Math.max(v, 24), most - 24);
    const edge = [inside(x, this.width), inside(y, this.canvas.clientHeight)], gone = [x - edge[0], y - edge[1]], far = Math.hypot(...gone);
    if (far > 36) { this.arrow(...edge, (12 * gone[0]) / far, (12 * gone[1]) / far, i === null ? "orange" : "blue"); return; }
    ctx.save(); ctx.translate(x, y); ctx.rotate(-turn);
    const length = scale * (front + rear + 1.6), broad = scale * (track + 0.25), left = -scale * (rear + 0.8);
    ctx.beginPath(); ctx.roundRect(left, -broad / 2, length, broad, broad / 4);
    ctx.lineWidth = 1.5; ctx.strokeStyle = colour(i === null ? "orange" : "ink");
    if (i === null) { ctx.setLineDash([5, 3]); ctx.stroke(); ctx.restore(); return; }
    ctx.fillStyle = colour("card"); ctx.fill(); ctx.stroke();
    ctx.fillStyle = colour("pale-blue"); ctx.fillRect(scale * (front - 0.75), -broad * 0.36, scale * 0.45, broad * 0.72);
    const wheel = (px, py, angle, name) => { ctx.save(); ctx.translate(px, py); ctx.rotate(-angle); ctx.fillStyle = colour(name); ctx.fillRect(-scale * 0.33, -scale * 0.11, scale * 0.66, scale * 0.22); ctx.restore(); };
    const steer = this.fails("torque") ? "warn" : "ink", push = this.fails("force-difference") ? "warn" : "ink";
    for (const side of [-1, 1]) {
      wheel(scale * front, (side * scale * track) / 2, STEERING_SHOWN * data.steering[i], steer);
      wheel(-scale * rear, (side * scale * track) / 2, 0, push);
      const most = setting.limits[1] || 4000, size = (side * data.applied_2[i]) / most; // the right wheel pushes for a turn to the left
      this.arrow(-scale * rear, (side * scale * track) / 2, 2.2 * scale * size, 0, "green");
    }
    ctx.beginPath(); ctx.arc(scale * front, 0, scale * 0.28, 0, 7); ctx.fillStyle = colour(steer === "warn" ? "warn" : "good"); ctx.fill();
    if (steer === "warn") { const r = scale * 0.28; this.line([[scale * front - r, -r], [scale * front + r, r]], "paper", 2); this.line([[scale * front - r, r], [scale * front + r, -r]], "paper", 2); }
    ctx.restore();
  }

  // An angle as a rod, and both inputs: the first at the pivot, the second at the tip.
  angle(width, height, i) {
    const { data, ctx } = this, long = height * 0.72, pivot = [width / 2, height - 14], words = this.inputs(i);
    const tip = (angle) => [pivot[0] + long * Math.sin(angle), pivot[1] - long * Math.cos(angle)];
    this.line([[pivot[0] - 60, pivot[1] + 6], [pivot[0] + 60, pivot[1] + 6]], "rule", 3);
    this.line([pivot, tip(data.reference[i])], "soft", 2, [6, 5]);
    const at = tip(data.output[i]), forces = this.shares(i), turn = data.output[i];
    this.line([pivot, at], "blue", 8);
    ctx.beginPath(); ctx.arc(...pivot, 9, 0, 7); ctx.fillStyle = colour(this.fails("torque") ? "warn" : "good"); ctx.fill();
    this.arrow(...at, 80 * forces[1] * Math.cos(turn), 80 * forces[1] * Math.sin(turn), this.fails("force-difference") ? "warn" : "green");
    this.arrow(pivot[0], pivot[1] - 16, 80 * forces[0], 0, this.fails("torque") ? "warn" : "green");
    return words;
  }

  position(width, height, i) {
    const { data, ctx } = this, most = 1.5 * [...data.reference, ...(data.x || [])].reduce((so, v) => Math.max(so, Math.abs(v || 0)), 1e-9), forces = this.shares(i);
    const two = data.x && data.x[i] !== null, side = 60, high = 40, y = height * 0.62, from = (two ? 0.35 : 0.5) * width;
    const x = (v) => from + ((two ? 0.15 : 0.35) * width * v) / most, at = [x(data.output[i]), ...(two ? [0.3 * width + x(data.x[i])] : [])];
    this.line([[width * 0.1, y + high / 2 + 3], [width * 0.9, y + high / 2 + 3]], "rule", 3);
    if (two) {
      const ends = [0.1 * width, ...at, 0.9 * width];
      for (const wall of [ends[0], ends[3]]) this.line([[wall, y - high / 2], [wall, y + high / 2]], "soft", 3);
      ends.slice(1).forEach((end, n) => this.spring(ends[n] + (n && side / 2), end - (n < 2 && side / 2), y));
    }
    this.line([[x(data.reference[i]), y - high], [x(data.reference[i]), y + high / 2]], "soft", 2, [6, 5]);
    ctx.fillStyle = colour("blue");
    for (const middle of at) ctx.fillRect(middle - side / 2, y - high / 2, side, high);
    ["torque", "force-difference"].forEach((name, n) => this.arrow(at[two ? n : 0], y - high / 2 - (two ? 8 : 20 - 12 * n), 120 * forces[n], 0, this.fails(name) ? "warn" : "green"));
    return this.inputs(i);
  }

  spring(from, to, y) { this.line(Array.from({ length: 14 }, (_, n) => [from + ((to - from) * n) / 13, n % 13 ? y + (n % 2 ? 7 : -7) : y]), "soft", 1.5); }

  // Any other plant: the loop as blocks, with the values on the lines between the blocks.
  blocks(width, height, i) {
    const { data, setting, ctx } = this, { units } = setting, y = this.middle, at = (share) => share * width, half = height < 180 ? 26 : 34, low = y + half + 16;
    const value = (share, above, v, n) => ctx.fillText(`${shown(v)} ${units[n]}`, at(share) + 6, above);
    const block = (from, to, name) => {
      ctx.beginPath(); ctx.rect(at(from), y - half, at(to) - at(from), 2 * half);
      ctx.fillStyle = colour("card"); ctx.fill(); ctx.strokeStyle = colour("ink"); ctx.lineWidth = 1.5; ctx.stroke();
      ctx.fillStyle = colour("ink"); ctx.fillText(name, at(from) + (half < 30 ? 4 : 8), y + 4);
    };
    if (setting.feedback) { this.line([[at(0.9), y], [at(0.9), low], [at(0.3), low], [at(0.3), y + half + 10]], "blue", 2); this.arrow(at(0.3), y + half + 10, 0, -3, "blue"); }
    this.arrow(at(0.02), y, at(0.19) - 7, 0, "soft"); this.arrow(at(0.8), y, at(0.19) - 7, 0, "blue");
    block(0.21, 0.39, "controller"); block(0.62, 0.8, "plant");
    ctx.fillStyle = colour("ink"); value(0.01, y - 8, data.reference[i], 0); value(0.8, y - 8, data.output[i], 0);
    ["torque", "force-difference"].forEach((name, n) => {
      const dead = this.fails(name), high = y - 16 + 32 * n;
      this.arrow(at(0.39), high, at(0.23) - 7, 0, dead ? "warn" : "green"); value(0.39, high - 6, data[`applied_${n + 1}`][i], n + 1);
      if (dead) for (const s of [-6, 6]) this.line([[at(0.5) - 6, high - s], [at(0.5) + 6, high + s]], "warn", 2);
    });
    return this.inputs(i);
  }

  // Both inputs as shares of the largest so far.
  shares(i) {
    return [1, 2].map((n) => {
      const values = this.data[`applied_${n}`], largest = values.reduce((most, v) => Math.max(most, Math.abs(v || 0)), 1e-9);
      return (values[i] || 0) / largest;
    });
  }

  inputs(i) {
    const { data, setting } = this, { names, units } = setting;
    return [`${names[0]} ${shown(data.output[i])} ${units[0]}`, ...[1, 2].map((n) => `${names[n]} ${shown(this.shares(i)[n - 1] ** 2 < 1e-12 ? 0 : data[`applied_${n}`][i])} ${units[n]}`)];
  }
}
