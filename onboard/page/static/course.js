// An answer's course: its value as a line in the band of its 95 % interval, over the time of the flight.
import {atScale} from "./format.js";

const SVG = "http://www.w3.org/2000/svg", WIDE = 300, HIGH = 60, POINTS = 400;

// Points [seconds, value, low, high]. Of more than POINTS every second is dropped, and they come half as often from then on.
export class Course {
  constructor(points = []) { this.points = points; this.every = 0.25; }
  add(point) {
    const last = this.points.at(-1);
    if (last && point[0] - last[0] < this.every) return;
    this.points.push(point);
    if (this.points.length > POINTS) { this.points = this.points.filter((_, i) => i % 2 === 0); this.every *= 2; }
  }
  until(seconds) { return this.points.filter(point => point[0] <= seconds); }
}

export function drawing() {
  const box = document.createElement("div"), svg = document.createElementNS(SVG, "svg");
  box.className = "course";
  svg.setAttribute("viewBox", `0 0 ${WIDE} ${HIGH}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  const [band, line] = ["band", "line"].map(kind => {
    const path = document.createElementNS(SVG, "path");
    path.setAttribute("class", kind);
    svg.append(path);
    return path;
  });
  const [top, bottom] = [document.createElement("span"), document.createElement("span")];
  box.append(svg, top, bottom);
  return {box, svg, band, line, top, bottom};
}

// The scale: all of it, but at most four of the last half intervals to each side. What was wider is cut off at the edge.
export function draw(to, points, until) {
  to.box.hidden = points.length < 2;
  if (to.box.hidden) return;
  const [, value, below, above] = points.at(-1), reach = 2 * (above - below);
  let low = Math.max(value - reach, Math.min(...points.map(point => point[2])));
  let high = Math.min(value + reach, Math.max(...points.map(point => point[3])));
  const space = 0.08 * (high - low) || Math.abs(high) || 1;
  low -= space; high += space;
  const from = points[0][0];
  const x = seconds => (WIDE * (seconds - from) / Math.max(1e-9, until - from)).toFixed(1);
  const y = value => Math.min(2 * HIGH, Math.max(-HIGH, HIGH * (high - value) / (high - low))).toFixed(1);
  const trace = (column, of = points) => of.map(point => `${x(point[0])},${y(point[column])}`).join("L");
  to.band.setAttribute("d", `M${trace(3)}L${trace(2, [...points].reverse())}Z`);
  to.line.setAttribute("d", `M${trace(1)}`);
  to.top.textContent = atScale(high, low, high);
  to.bottom.textContent = atScale(low, low, high);
  to.svg.setAttribute("aria-label", `its course: between ${atScale(low, low, high)} and ${atScale(high, low, high)}`);
}
