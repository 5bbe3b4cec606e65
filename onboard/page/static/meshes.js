// Triangles of the URDF's meshes on a plain canvas: those farther away first, each as bright as it faces the viewer. Of a
// closed surface those that face away are left out.
const LIGHT = 0.45, CLOSED = 0.03;

// `corners` by link, nine numbers a triangle, in the link's frame; and how many visuals are left out.
export async function fetched() {
  try {
    const response = await fetch("meshes", {cache: "no-store"});
    const {corners, left_out} = response.ok ? await response.json() : {corners: {}, left_out: 0};
    return {meshes: Object.entries(corners).map(([link, numbers]) => ({link, corners: Float64Array.from(numbers), ...shape(numbers)})), leftOut: left_out};
  } catch {
    return {meshes: [], leftOut: 0};  // the page says that there is no connection; lines are drawn
  }
}

const normal = (a, b, c) => {
  const u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
  return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
};

// Corners of the box around it; and which side of its triangles is outside: 1 or -1, 0 where the surface is open.
function shape(numbers) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], sum = [0, 0, 0];
  let area = 0, volume = 0;
  for (let i = 0; i < numbers.length; i += 9) {
    const [a, b, c] = [0, 3, 6].map(k => numbers.slice(i + k, i + k + 3)), n = normal(a, b, c);
    n.forEach((v, k) => { sum[k] += v; });
    area += Math.hypot(...n); volume += n[0] * a[0] + n[1] * a[1] + n[2] * a[2];
    for (const one of [a, b, c]) one.forEach((v, k) => { low[k] = Math.min(low[k], v); high[k] = Math.max(high[k], v); });
  }
  const box = [0, 1, 2, 3, 4, 5, 6, 7].map(bits => low.map((v, k) => bits >> k & 1 ? high[k] : v));
  return {box, side: Math.hypot(...sum) < CLOSED * area ? Math.sign(volume) : 0};
}

// Colours by how much a triangle faces the viewer, from one that is seen from its edge on.
export function shades(dark) {
  return Array.from({length: 16}, (_, i) => {
    const share = LIGHT + (1 - LIGHT) * i / 15, [low, high] = dark ? [34, 150] : [120, 226];
    const grey = Math.round(low + share * (high - low));
    return `rgb(${grey},${grey},${Math.min(255, grey + 8)})`;
  });
}

// `toward`: unit vector to the viewer, base axes.
export function paint(pen, meshes, frames, place, toward, inks) {
  const found = [];
  for (const {link, corners, side} of meshes) {
    const frame = frames[link];
    if (!frame) continue;
    const {R, p} = frame, moved = new Float64Array(corners.length);
    for (let i = 0; i < corners.length; i += 3) {
      for (let k = 0; k < 3; k++) moved[i + k] = R[k][0] * corners[i] + R[k][1] * corners[i + 1] + R[k][2] * corners[i + 2] + p[k];
    }
    for (let i = 0; i < moved.length; i += 9) {
      const a = moved.subarray(i, i + 3), b = moved.subarray(i + 3, i + 6), c = moved.subarray(i + 6, i + 9);
      const n = normal(a, b, c), facing = n[0] * toward[0] + n[1] * toward[1] + n[2] * toward[2];
      if (side * facing < 0) continue;
      const faces = facing ? Math.abs(facing) / Math.hypot(...n) : 0;
      const near = (a[0] + b[0] + c[0]) * toward[0] + (a[1] + b[1] + c[1]) * toward[1] + (a[2] + b[2] + c[2]) * toward[2];
      found.push({near, ink: inks[Math.round(15 * faces)], at: [a, b, c]});
    }
  }
  found.sort((one, two) => one.near - two.near);
  pen.lineJoin = "round"; pen.lineWidth = 0.7;
  for (const {ink, at} of found) {
    pen.fillStyle = pen.strokeStyle = ink;  // the line covers the seam between neighbours
    pen.beginPath();
    pen.moveTo(...place(at[0])); pen.lineTo(...place(at[1])); pen.lineTo(...place(at[2]));
    pen.closePath(); pen.fill(); pen.stroke();
  }
  return found.length;
}
