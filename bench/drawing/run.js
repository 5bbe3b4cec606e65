// The task of both pages: four times a second new positions of the joints and longer courses. `window.painted_ms`: when the
// first of it was on the screen, since the navigation began.
const FRAME_MS = 250;
window.frames_drawn = 0;

export function run(task, ready, show, plot) {
  let number = 0;
  const next = () => {
    const until = 60 + (number % 60), q = task.tree.joints.filter(one => one.q !== null).map((_, i) => Math.sin(0.3 * number + i));
    show(q);
    plot(task.courses.map(points => points.filter(one => one[0] <= until)), until);
    number += 1;
  };
  const begin = () => {
    if (!ready()) { setTimeout(begin, 1); return; }
    next();
    requestAnimationFrame(() => requestAnimationFrame(() => { window.painted_ms = performance.now(); }));
    setInterval(next, FRAME_MS);
  };
  begin();
}
