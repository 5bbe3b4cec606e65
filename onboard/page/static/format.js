// Numbers as text. All of them end up in textContent, as every text does: nothing of a flight is ever read as HTML.
const SUPER = {"-": "\u207b", 0: "\u2070", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3", 4: "\u2074", 5: "\u2075", 6: "\u2076", 7: "\u2077", 8: "\u2078", 9: "\u2079"};
const raised = number => [...String(number)].map(mark => SUPER[mark]).join("");

export const unitText = unit => unit.replace(/\^(-?\d+)/g, (_, digits) => raised(digits));

// Value and half interval to two digits of the latter: "0.0642 \u00b1 0.0019", "3.029\u00d710\u207b\u2075 \u00b1 0.026\u00d710\u207b\u2075".
export function withInterval(value, half, size = Math.max(Math.abs(value), half)) {
  if (!(size > 0)) return ["0", "\u00b1 0"];
  const order = Math.floor(Math.log10(size)), shift = order < -4 || order > 5 ? order : 0;
  const finest = half > 0 ? Math.floor(Math.log10(half)) - 1 : order - 5;
  const digits = Math.min(12, Math.max(0, shift - finest)), scale = 10 ** shift;
  const power = shift ? `\u00d710${raised(shift)}` : "";
  return [(value / scale).toFixed(digits) + power, `\u00b1 ${(half / scale).toFixed(digits)}${power}`];
}

// One end of an axis from `low` to `high`: to a hundredth of its length, both ends to the same power of ten.
export function atScale(number, low, high) {
  return withInterval(number, Math.max(high - low, 1e-300) / 10, Math.max(Math.abs(low), Math.abs(high)))[0];
}

export const rate = number => number === null ? "-" : number >= 100 ? number.toFixed(0) : number >= 10 ? number.toFixed(1) : number.toFixed(2);

export function age(seconds) {
  if (seconds === null) return "-";
  if (seconds > 0 && seconds < 1e-3) return `${(1e6 * seconds).toFixed(0)} \u00b5s`;
  if (seconds < 1) return `${Math.max(0, 1e3 * seconds).toFixed(0)} ms`;
  return seconds < 600 ? `${seconds.toFixed(1)} s` : `${(seconds / 60).toFixed(0)} min`;
}

export function clockText(seconds) {
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const whole = Math.floor(seconds), pad = number => String(number).padStart(2, "0");
  const hours = Math.floor(whole / 3600);
  return `${hours ? `${hours}:` : ""}${hours ? pad(Math.floor(whole / 60) % 60) : Math.floor(whole / 60)}:${pad(whole % 60)}.${Math.floor(10 * (seconds % 1))}`;
}

export const count = number => number.toLocaleString("en-US");

// Times between two ends, in seconds, at whole steps of the clock, as many as `most`; and what stands beside them.
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 18000, 36000];
export function ticks(from, to, most) {
  const least = (to - from) / Math.max(1, most), whole = 10 ** Math.floor(Math.log10(least));
  const step = least < 1 ? [1, 2, 5, 10].map(one => one * whole).find(one => one >= least) : STEPS.find(one => one >= least) ?? 36000 * Math.ceil(least / 36000);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), first = Math.ceil(from / step - 1e-9), found = [];
  for (let i = first; i * step <= to + 1e-9 * step; i++) found.push([i * step, to < 60 || step < 1 ? `${(i * step).toFixed(digits)} s` : clockText(i * step).replace(/\.\d$/, "")]);
  return found;
}
