// A canvas without a browser: writes down areas, lines and texts in pixels, for `views.film`.
"use strict";

const devicePixelRatio = 1, ROUND = 24;
const document = {}, matchMedia = () => ({ addEventListener() {} });
const getComputedStyle = () => ({ getPropertyValue: (name) => name });
class ResizeObserver { observe() {} }

class Pen {
  constructor() { Object.assign(this, { drawn: [], kept: [], path: [], dash: [], box: null, m: [1, 0, 0, 1, 0, 0] }); }
  save() { this.kept.push([this.m, this.dash, this.box]); }
  restore() { [this.m, this.dash, this.box] = this.kept.pop(); }
  setTransform(...m) { this.m = m; }
  turned(a, b, c, d, e, f) { const [p, q, r, s, x, y] = this.m; this.m = [p * a + r * b, q * a + s * b, p * c + r * d, q * c + s * d, p * e + r * f + x, q * e + s * f + y]; }
  translate(x, y) { this.turned(1, 0, 0, 1, x, y); }
  rotate(t) { this.turned(Math.cos(t), Math.sin(t), -Math.sin(t), Math.cos(t), 0, 0); }
  at(x, y) { const [a, b, c, d, e, f] = this.m; return [a * x + c * y + e, b * x + d * y + f]; }
  beginPath() { this.path = []; }
  moveTo(x, y) { this.path.push([this.at(x, y)]); }
  lineTo(x, y) { this.path.at(-1).push(this.at(x, y)); }
  arc(x, y, r, from, to) { this.path.push(Array.from({ length: ROUND + 1 }, (_, i) => { const t = from + ((Math.min(to, from + 2 * Math.PI) - from) * i) / ROUND; return this.at(x + r * Math.cos(t), y + r * Math.sin(t)); })); }
  rect(x, y, w, h) { this.path.push([[x, y], [x + w, y], [x + w, y + h], [x, y + h], [x, y]].map((p) => this.at(...p))); }
  roundRect(x, y, w, h, r) {
    const corner = (cx, cy, from) => { this.arc(cx, cy, r, from, from + Math.PI / 2); return this.path.pop(); };
    const around = [corner(x + r, y + r, Math.PI), corner(x + w - r, y + r, 1.5 * Math.PI), corner(x + w - r, y + h - r, 0), corner(x + r, y + h - r, Math.PI / 2)].flat();
    this.path.push([...around, around[0]]);
  }
  clip() { const [all] = this.path; this.box = [Math.min(...all.map((p) => p[0])), Math.max(...all.map((p) => p[0]))]; }
  setLineDash(dash) { this.dash = dash; }
  stroke() { for (const points of this.path) this.drawn.push({ points, colour: this.strokeStyle, width: this.lineWidth, dash: this.dash, box: this.box }); }
  fill() { for (const points of this.path) this.drawn.push({ points, colour: this.fillStyle, width: 0, dash: [], box: this.box }); }
  fillRect(...box) { this.beginPath(); this.rect(...box); this.fill(); }
  clearRect() { this.drawn = []; }
  fillText(text, x, y) { this.drawn.push({ text, points: [this.at(x, y)], colour: this.fillStyle }); }
}

class Paper {
  constructor(width, height) { Object.assign(this, { clientWidth: width, clientHeight: height, pen: new Pen() }); }
  setAttribute() {}
  getContext() { return this.pen; }
}
