// The arm as measured: the URDF's joints as lines, its meshes where there are files, what is held as the ellipsoid of its
// inertia. Drag to turn it.
import {fetched, paint, shades} from "./meshes.js";

const SETTLE_MS = 250, TURNS = 24, SLOW_MS = 12;

// Frames are {R: rows of the rotation to base axes, p: origin in base axes}.
const rotate = (R, v) => R.map(row => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const multiply = (A, B) => A.map(row => [0, 1, 2].map(j => row[0] * B[0][j] + row[1] * B[1][j] + row[2] * B[2][j]));
const plus = (a, b) => a.map((v, i) => v + b[i]);

function about(axis, angle) {  // Rodrigues
  const [x, y, z] = axis, c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
  return [[c + x * x * d, x * y * d - z * s, x * z * d + y * s], [y * x * d + z * s, c + y * y * d, y * z * d - x * s], [z * x * d - y * s, z * y * d + x * s, c + z * z * d]];
}

export function links(tree, q) {
  const found = {[tree.root]: {R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], p: [0, 0, 0]}};
  for (const joint of tree.joints) {
    const base = found[joint.parent], [roll, pitch, yaw] = joint.rpy;
    const fixed = multiply(about([0, 0, 1], yaw), multiply(about([0, 1, 0], pitch), about([1, 0, 0], roll)));
    let R = multiply(base.R, fixed), p = plus(base.p, rotate(base.R, joint.xyz));
    const value = joint.q === null ? 0 : q?.[joint.q] ?? 0;
    if (joint.moves === "turns") R = multiply(R, about(joint.axis, value));
    if (joint.moves === "slides") p = plus(p, rotate(R, joint.axis.map(v => v * value)));
    found[joint.child] = {R, p};
  }
  return found;
}

// Principal moments and axes of a symmetric tensor, by Jacobi's rotations.
export function principal(tensor) {
  let A = tensor.map(row => [...row]), V = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 12; sweep++) {
    for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
      if (Math.abs(A[i][j]) < 1e-14 * (Math.abs(A[i][i]) + Math.abs(A[j][j]))) continue;
      const angle = 0.5 * Math.atan2(2 * A[i][j], A[i][i] - A[j][j]), c = Math.cos(angle), s = Math.sin(angle);
      const J = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
      J[i][i] = c; J[j][j] = c; J[i][j] = -s; J[j][i] = s;
      A = multiply(J[0].map((_, k) => J.map(row => row[k])), multiply(A, J));
      V = multiply(V, J);
    }
  }
  return {moments: [A[0][0], A[1][1], A[2][2]], axes: V};
}

// The body that is held, in the frame of its link: semi-axes (m) of the uniform ellipsoid with its mass and inertia.
export function bodyOf(held, payload) {
  const known = Object.fromEntries(held.map(one => [one.name, one]));
  const take = kinds => kinds.map(kind => known[`${kind}_${payload}`]);
  const parts = take(["m", "c_x", "c_y", "c_z"]);
  if (parts.some(one => !one?.supported || one.value === null)) return null;
  const [mass, ...centre] = parts.map(one => one.value), half = parts.slice(1).map(one => (one.high - one.low) / 2);
  const tensor = take(["I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz"]);
  if (!(mass > 0)) return null;
  const body = {centre, half, semi: null, axes: null};
  if (tensor.every(one => one?.supported && one.value !== null)) {
    const [xx, xy, yy, xz, yz, zz] = tensor.map(one => one.value);
    const {moments, axes} = principal([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]);
    const total = moments[0] + moments[1] + moments[2], squares = moments.map(one => 2.5 * (total - 2 * one) / mass);
    if (squares.every(one => one > 0)) Object.assign(body, {semi: squares.map(Math.sqrt), axes});
  }
  return body;
}

export class Arm {
  constructor(box) {
    this.box = box;
    this.canvas = box.querySelector("canvas");
    this.tree = null; this.q = null; this.from = null; this.since = 0; this.held = []; this.waiting = false; this.meshes = []; this.leftOut = 0; this.cost = 0;
    this.turn = 0.7; this.tilt = 0.45; this.middle = null;
    this.canvas.onpointerdown = event => this.canvas.setPointerCapture(event.pointerId);
    this.canvas.onpointermove = event => {
      if (!event.buttons) return;
      this.turn += event.movementX / 120; this.tilt += event.movementY / 120; this.later();
    };
    this.canvas.onkeydown = event => {
      const by = {ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15]}[event.key];
      if (!by) return;
      event.preventDefault();
      this.turn += by[0]; this.tilt += by[1]; this.later();
    };
    new ResizeObserver(() => this.later()).observe(box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.later());
  }

  begin(tree, meshes) {
    this.tree = tree; this.q = this.from = this.middle = null; this.held = [];
    this.box.hidden = true;
    this.reach = 0; this.meshes = []; this.leftOut = 0; this.cost = 0;
    if (tree && meshes) fetched().then(got => { if (this.tree === tree) { Object.assign(this, got); this.later(); } });
    if (tree) for (const joint of tree.joints) this.reach += Math.hypot(...joint.xyz) * (joint.moves ? 1 : 0.3);
  }

  // New positions; they are moved to in the time until the next frame, or at once.
  show(q, held, smoothly) {
    const count = this.tree ? this.tree.joints.filter(joint => joint.q !== null).length : -1;
    this.box.hidden = !q || q.length !== count;
    if (this.box.hidden) return;
    this.from = smoothly && this.q ? this.now() : null;
    this.q = q; this.held = held; this.since = performance.now();
    this.later();
  }

  now() {
    const share = Math.min(1, (performance.now() - this.since) / SETTLE_MS);
    return this.from ? this.q.map((value, i) => this.from[i] + share * (value - this.from[i])) : this.q;
  }

  later() {
    if (this.waiting || this.box.hidden) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      const began = performance.now();
      this.draw();
      this.cost = performance.now() - began;
      if (this.cost > SLOW_MS) this.from = null;  // a frame at a time: the page has other things to do
      if (this.from && performance.now() - this.since < SETTLE_MS) this.later();
    });
  }

  draw() {
    if (!this.tree || !this.q) return;
    const style = getComputedStyle(document.documentElement), colour = name => style.getPropertyValue(`--${name}`).trim();
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight, sharp = window.devicePixelRatio || 1;
    this.canvas.width = width * sharp; this.canvas.height = height * sharp;
    const pen = this.canvas.getContext("2d"), at = links(this.tree, this.now());
    pen.scale(sharp, sharp);
    const boxes = this.meshes.filter(one => at[one.link]).flatMap(one => one.box.map(v => plus(at[one.link].p, rotate(at[one.link].R, v))));
    const points = [...Object.values(at).map(one => one.p), ...boxes], low = [0, 1, 2].map(i => Math.min(...points.map(p => p[i]))), high = [0, 1, 2].map(i => Math.max(...points.map(p => p[i])));
    const centre = low.map((v, i) => (v + high[i]) / 2), reach = this.reach = Math.max(1e-3, this.reach, Math.hypot(...low.map((v, i) => high[i] - v)));
    const c = Math.cos(this.turn), s = Math.sin(this.turn), ct = Math.cos(this.tilt), st = Math.sin(this.tilt), scale = 0.9 * Math.min(width, height) / reach;
    if (!this.middle || Math.hypot(...centre.map((v, i) => v - this.middle[i])) > 0.2 * reach) this.middle = centre;  // else it stands still
    const middle = this.middle;
    const place = p => {
      const [x, y, z] = p.map((v, i) => v - middle[i]);
      return [width / 2 + scale * (c * x - s * y), height / 2 - scale * (ct * z + st * (s * x + c * y))];
    };
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    this.box.dataset.triangles = paint(pen, this.meshes, at, place, [-s * ct, -c * ct, st], shades(dark));
    const line = (one, two, ink, thick) => { pen.strokeStyle = ink; pen.lineWidth = thick; pen.lineCap = "round"; pen.beginPath(); pen.moveTo(...place(one)); pen.lineTo(...place(two)); pen.stroke(); };
    ["b", "c", "a"].forEach((ink, i) => {
      const end = [0, 0, 0]; end[i] = reach / 8;
      line([0, 0, 0], end, colour(ink), 1.5);
      pen.fillStyle = colour(ink); pen.font = "11px system-ui, sans-serif"; pen.fillText("xyz"[i], ...place(end));
    });
    const moved = new Set();
    for (const joint of this.tree.joints) {
      if (joint.moves || moved.has(joint.parent)) moved.add(joint.child);
      line(at[joint.parent].p, at[joint.child].p, colour(moved.has(joint.child) ? "a" : "idle"), moved.has(joint.parent) ? 4 : 2);
    }
    for (const joint of this.tree.joints) if (joint.moves) {
      pen.fillStyle = colour("ink"); pen.beginPath(); pen.arc(...place(at[joint.child].p), 3, 0, 7); pen.fill();
    }
    this.body(at, line, colour);
  }

  body(at, line, colour) {
    const frame = at[this.tree.payload], body = frame && bodyOf(this.held, this.tree.payload);
    const said = body ? [`${body.semi ? "ellipsoid of its inertia; " : ""}cross: its centre, 95 %`] : [];
    if (this.leftOut) said.push(`${this.leftOut} shapes of the URDF are not drawn: their files are not at hand, or no STL or OBJ`);
    put(this.box.querySelector("p"), said.join("; "));
    if (!body) return;
    const inBase = v => plus(frame.p, rotate(frame.R, v));
    body.half.forEach((half, i) => {
      const end = [0, 0, 0]; end[i] = half;
      line(inBase(plus(body.centre, end.map(v => -v))), inBase(plus(body.centre, end)), colour("true"), 3);
    });
    if (!body.semi) return;
    for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
      let before = null;
      for (let k = 0; k <= TURNS; k++) {
        const own = [0, 0, 0], angle = 2 * Math.PI * k / TURNS;
        own[i] = body.semi[i] * Math.cos(angle); own[j] = body.semi[j] * Math.sin(angle);
        const next = inBase(plus(body.centre, rotate(body.axes, own)));
        if (before) line(before, next, colour("b"), 1);
        before = next;
      }
    }
  }
}

const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };
