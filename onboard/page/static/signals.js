// Samples of a device over time: the band from the lowest to the highest of every step. Zoom by buttons, keys, or a drag.
import {age, atScale, ticks, unitText} from "./format.js";

const SVG = "http://www.w3.org/2000/svg", WIDE = 1000, HIGH = 200, EACH_MS = 1000, LEAST_S = 0.2, MOST_POINTS = 4800, GAP = 5, EACH_PX = 64, EDGE_PX = 24;
const INKS = ["a", "b", "c", "d"];
const at = id => document.getElementById(id);
const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };

export class Signals {
  constructor() {
    this.box = at("signals"); this.svg = this.box.querySelector("svg"); this.select = at("signal");
    this.flight = null; this.signal = null; this.names = ""; this.now = 0; this.asked = -Infinity; this.busy = false; this.seen = false;
    this.span = null; this.end = null;  // seconds; no span: all, no end: the newest
    this.select.onchange = () => { this.signal = null; this.asked = -Infinity; this.look(); };
    const acts = {in: () => this.zoom(0.5), out: () => this.zoom(2), earlier: () => this.pan(-0.5), later: () => this.pan(0.5), all: () => { this.span = this.end = null; }, pause: () => { this.end = this.end === null ? this.edges()[1] : null; }};
    for (const [name, act] of Object.entries(acts)) at(`signal-${name}`).onclick = () => { act(); this.draw(); };
    const keys = {"+": "in", "-": "out", ArrowLeft: "earlier", ArrowRight: "later", "0": "all", " ": "pause"};
    this.svg.onkeydown = event => {
      const act = keys[event.key];
      if (!act || at(`signal-${act}`).hidden || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      acts[act](); this.draw();
    };
    this.drags();
    new ResizeObserver(() => this.draw()).observe(this.svg);
    new IntersectionObserver(found => { this.seen = found.at(-1).isIntersecting; this.look(); this.draw(); }).observe(this.box);
  }

  begin(flight) {
    this.flight = flight; this.signal = null; this.names = ""; this.asked = -Infinity; this.span = this.end = null;
    at("signal-pause").hidden = !flight.live;
    this.look();
  }

  show(seconds) { this.now = seconds; this.look(); this.draw(); }

  // What came since the last look: of a flight once a second while it is on the screen, of a log once.
  async look() {
    const late = performance.now() - this.asked, due = this.flight && (this.flight.live ? late >= EACH_MS : !this.signal && late >= EACH_MS);
    if (!due || !this.seen || document.hidden || this.busy) return;
    this.busy = true; this.asked = performance.now();
    const name = this.select.value, flight = this.flight, before = this.signal?.points.length < MOST_POINTS ? this.signal.points : [];
    const since = before.length > 1 ? before.at(-2)[0] : -1e9;
    try {
      const response = await fetch(`signals?${new URLSearchParams({name, since})}`, {cache: "no-store"});
      if (response.ok) this.take(await response.json(), name, flight, before.slice(0, -2));
    } catch { /* the page says it */ }
    this.busy = false;
  }

  take(got, name, flight, before) {
    if (flight !== this.flight) return;
    if (this.names !== got.names.join("\n")) {
      this.names = got.names.join("\n");
      this.select.replaceChildren(...got.names.map(one => new Option(one, one, false, one === name)));
    }
    at("no-signal").hidden = got.names.length > 0;
    for (const part of this.box.querySelectorAll(".tools, .plot")) part.hidden = !got.names.length;
    if (this.select.value !== name) { this.asked = -Infinity; this.signal = null; setTimeout(() => this.look()); return; }
    this.signal = got.signal && {...got.signal, points: before.concat(got.signal.points)};
    this.draw();
  }

  // First and last second of what is shown.
  edges() {
    const points = this.signal?.points ?? [], first = points[0]?.[0] ?? 0, last = this.flight.live ? points.at(-1)?.[0] ?? 0 : this.flight.steps.at(-1);
    const end = this.end ?? last;
    return [this.span === null ? Math.min(first, end) : end - this.span, end];
  }

  zoom(by) {
    const [from, to] = this.edges(), span = Math.max(LEAST_S, (to - from) * by), middle = (from + to) / 2;
    if (this.end !== null || !this.flight.live) this.end = middle + span / 2;
    this.span = span;
    this.hold();
  }

  pan(by) {
    const [from, to] = this.edges();
    this.span = to - from; this.end = to + by * this.span;
    this.hold();
  }

  // Not beyond what there is.
  hold() {
    const points = this.signal?.points ?? [];
    if (points.length < 2) return;
    const first = points[0][0], last = this.flight.live ? points.at(-1)[0] : this.flight.steps.at(-1);
    if (this.span >= last - first) { this.span = null; this.end = this.end !== null && this.flight.live ? last : null; } else if (this.end !== null) this.end = Math.min(last, Math.max(first + this.span, this.end));
  }

  drags() {
    const seconds = event => {
      const {left, width} = this.svg.getBoundingClientRect(), [from, to] = this.edges();
      return from + (to - from) * Math.min(1, Math.max(0, (event.clientX - left) / width));
    };
    let one = null;
    const mark = this.svg.querySelector(".mark");
    this.svg.onpointerdown = event => { one = seconds(event); this.held = this.edges(); this.svg.setPointerCapture(event.pointerId); };
    this.svg.onpointermove = event => {
      if (one === null) return;
      const [from, to] = this.edges(), x = t => WIDE * (t - from) / (to - from), two = seconds(event);
      mark.setAttribute("x", Math.min(x(one), x(two))); mark.setAttribute("width", Math.abs(x(two) - x(one)));
    };
    this.svg.onpointerup = event => {
      const two = seconds(event);
      if (one !== null && Math.abs(two - one) >= LEAST_S) { this.end = Math.max(one, two); this.span = Math.abs(two - one); }
      this.svg.onpointercancel();
    };
    this.svg.onpointercancel = () => { one = null; this.held = null; mark.setAttribute("width", 0); this.draw(); };
  }

  draw() {
    if (!this.flight || !this.signal || this.held || !this.seen) return;
    const [from, to] = this.edges(), {components, unit, every_s, points} = this.signal;
    const shown = points.filter(point => point[0] >= from - every_s && point[0] <= to), ends = shown.flatMap(point => point.slice(1));
    let low = ends.reduce((a, b) => Math.min(a, b), Infinity), high = ends.reduce((a, b) => Math.max(a, b), -Infinity);
    if (!ends.length) low = high = 0;
    const space = 0.06 * (high - low) || 1e-3 * Math.abs(high) || 1;
    low -= space; high += space;
    const x = t => (WIDE * (t - from) / Math.max(1e-9, to - from)).toFixed(1), y = v => (HIGH * (high - v) / (high - low)).toFixed(1);
    const steps = shown.slice(1).map((point, i) => point[0] - shown[i][0]).sort((a, b) => a - b), wide = GAP * (steps[steps.length >> 1] ?? 1);
    const parts = [];
    shown.forEach((point, i) => { if (!i || point[0] - shown[i - 1][0] > wide) parts.push([]); parts.at(-1).push(point); });
    const bands = this.svg.querySelector(".bands");
    while (bands.children.length > components.length) bands.lastChild.remove();
    while (bands.children.length < components.length) bands.append(document.createElementNS(SVG, "path"));
    components.forEach((_, i) => {
      const trace = (part, end) => part.map(point => `${x(point[0])},${y(point[1 + 2 * i + end])}`).join("L");
      bands.children[i].setAttribute("class", INKS[i]);
      bands.children[i].setAttribute("d", parts.map(part => `M${trace(part, 1)}L${trace([...part].reverse(), 0)}Z`).join(""));
    });
    this.time(from, to, x);
    const cursor = this.svg.querySelector(".cursor"), past = this.flight.live ? -10 : x(this.now);
    cursor.setAttribute("x1", past); cursor.setAttribute("x2", past);
    this.tell(from, to, low, high, components, unit, every_s, shown.at(-1));
  }

  // Lines at whole times, and the times under them, but at the edges, where they would be cut.
  time(from, to, x) {
    const wide = this.svg.clientWidth, found = ticks(from, to, wide / EACH_PX), times = at("signal-times");
    const lines = this.svg.querySelector(".ticks");
    if (!lines.firstChild) lines.append(document.createElementNS(SVG, "path"));
    lines.firstChild.setAttribute("d", found.map(([t]) => `M${x(t)},0V${HIGH}`).join(""));
    const told = found.filter(([t]) => { const px = wide * x(t) / WIDE; return px > EDGE_PX && px < wide - EDGE_PX; });
    while (times.children.length > told.length) times.lastChild.remove();
    while (times.children.length < told.length) times.append(document.createElement("span"));
    told.forEach(([t, text], i) => { put(times.children[i], text); times.children[i].style.left = `${x(t) / WIDE * 100}%`; });
  }

  tell(from, to, low, high, components, unit, every_s, last) {
    const digits = to - from < 20 ? 2 : 0;
    put(at("signal-from"), `${from.toFixed(digits)} s`); put(at("signal-to"), `${to.toFixed(digits)} s`);
    const shown = unit === "1" ? "" : ` ${unitText(unit)}`;
    put(at("signal-high"), atScale(high, low, high) + shown); put(at("signal-low"), atScale(low, low, high) + shown);
    put(at("signal-step"), `lowest and highest of every ${age(every_s)}`);
    const legend = at("signal-legend");
    legend.replaceChildren(...components.filter(Boolean).map((name, i) => Object.assign(document.createElement("span"), {className: INKS[i], textContent: name})));
    const paused = this.flight.live && this.end !== null, pause = at("signal-pause");
    put(pause, paused ? "resume" : "pause");
    this.box.classList.toggle("paused", paused);
    this.svg.setAttribute("aria-label", `${this.select.value} from ${from.toFixed(1)} to ${to.toFixed(1)} s: between ${atScale(low, low, high)} and ${atScale(high, low, high)} ${unit}${last ? "" : ", no sample"}; plus and minus zoom, arrow keys move, 0 shows all`);
  }
}
