// The arm over time: drag to turn it, the slider or the button moves the time. Without scripts the drawing stays.
for (const box of document.querySelectorAll(".arm")) {
  const data = JSON.parse(box.querySelector("script").textContent);
  const count = data.names.length, canvas = document.createElement("canvas"), bar = document.createElement("div");
  const slider = document.createElement("input"), button = document.createElement("button"), label = document.createElement("output");
  slider.type = "range"; slider.min = 0; slider.max = data.time.length - 1; slider.value = 0;
  slider.setAttribute("aria-label", "time");
  button.type = "button"; button.textContent = "play";
  bar.className = "bar"; bar.append(button, slider, label);
  box.append(canvas, bar);
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const pose of data.mm)
    pose.forEach((v, i) => { low[i % 3] = Math.min(low[i % 3], v); high[i % 3] = Math.max(high[i % 3], v); });
  const middle = low.map((v, i) => (v + high[i]) / 2);
  const reach = Math.max(1, Math.hypot(...low.map((v, i) => high[i] - v)) / 2);
  let turn = 0, tilt = 0.45, near = 1, timer = null, widest = -1;
  for (let angle = -1.5; angle < 1.5; angle += 0.25) {  // begin where the vehicle is widest
    const across = data.mm.flatMap(pose => Array.from({length: count}, (_, i) => Math.cos(angle) * pose[3 * i] - Math.sin(angle) * pose[3 * i + 1]));
    const wide = across.reduce((a, b) => Math.max(a, b), -Infinity) - across.reduce((a, b) => Math.min(a, b), Infinity);
    if (wide > widest) { widest = wide; turn = angle; }
  }
  function draw() {
    const style = getComputedStyle(document.documentElement), colour = name => style.getPropertyValue("--" + name).trim();
    const width = box.clientWidth, height = Math.min(420, Math.max(260, 0.6 * width)), sharp = window.devicePixelRatio || 1;
    canvas.width = width * sharp; canvas.height = height * sharp;
    canvas.style.width = width + "px"; canvas.style.height = height + "px";
    const pen = canvas.getContext("2d"), pose = data.mm[+slider.value], scale = 0.44 * near * Math.min(width, height) / reach;
    pen.scale(sharp, sharp);
    const c = Math.cos(turn), s = Math.sin(turn), ct = Math.cos(tilt), st = Math.sin(tilt);
    const place = p => {
      const [x, y, z] = p.map((v, i) => v - middle[i]), a = c * x - s * y, b = s * x + c * y;
      return [width / 2 + scale * a, height / 2 - scale * (ct * z + st * b)];
    };
    const line = (one, two, ink, thick) => {
      pen.strokeStyle = ink; pen.lineWidth = thick; pen.beginPath(); pen.moveTo(...one); pen.lineTo(...two); pen.stroke();
    };
    const size = reach / 4, origin = place([0, 0, 0]);
    pen.font = "12px system-ui, sans-serif";
    [["x", [size, 0, 0], "b"], ["y", [0, size, 0], "c"], ["z", [0, 0, size], "a"]].forEach(([name, end, ink]) => {
      const at = place(end); line(origin, at, colour(ink), 1); pen.fillStyle = colour(ink); pen.fillText(name, at[0] + 2, at[1]);
    });
    const spots = Array.from({length: count}, (_, i) => place(pose.slice(3 * i, 3 * i + 3)));
    for (const [one, two] of data.lines) line(spots[one], spots[two], colour(data.moving[two] ? "a" : "idle"), data.moving[two] ? 4 : 2);
    const written = [];
    spots.forEach(([x, y], i) => {
      pen.fillStyle = colour(data.moving[i] ? "ink" : "faint");
      pen.beginPath(); pen.arc(x, y, 3, 0, 7); pen.fill();
      if (data.names[i] && !written.some(([u, v]) => Math.abs(v - y) < 12 && Math.abs(u - x) < 70)) {
        written.push([x, y]); pen.fillText(data.names[i].slice(0, 24), x + 5, y - 5);
      }
    });
    label.textContent = data.time[+slider.value].toFixed(2) + " s";
  }
  slider.oninput = draw;
  button.onclick = () => {
    if (timer) { clearInterval(timer); timer = null; button.textContent = "play"; return; }
    button.textContent = "stop";
    timer = setInterval(() => { slider.value = (+slider.value + 1) % data.time.length; draw(); }, 50);
  };
  canvas.onpointerdown = e => canvas.setPointerCapture(e.pointerId);
  canvas.onpointermove = e => { if (e.buttons) { turn += e.movementX / 120; tilt += e.movementY / 120; draw(); } };
  canvas.addEventListener("wheel", e => {
    if (e.ctrlKey) { e.preventDefault(); near = Math.min(20, Math.max(0.2, near * Math.exp(-e.deltaY / 200))); draw(); }
  }, {passive: false});
  new ResizeObserver(draw).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
}

// Figures that zoom take the place of the drawings when they come near; whatever fails leaves the drawing.
(async () => {
  const packed = id => document.getElementById(id);
  if (!packed("bokeh") || !window.DecompressionStream || !window.IntersectionObserver) return;
  const unpack = async id => {
    const bytes = Uint8Array.from(atob(packed(id).textContent), c => c.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };
  const library = document.createElement("script");
  library.textContent = await unpack("bokeh");
  document.head.append(library);
  if (!window.Bokeh) return;
  let text = await unpack("figures");
  const style = getComputedStyle(document.documentElement);
  for (const [role, colour] of Object.entries(JSON.parse(await unpack("roles"))))
    text = text.replaceAll(colour, style.getPropertyValue("--" + role).trim());
  const figures = JSON.parse(text), coarse = matchMedia("(pointer: coarse)").matches;
  const seen = new IntersectionObserver(entries => {
    for (const {target, isIntersecting} of entries) if (isIntersecting) { seen.unobserve(target); show(target); }
  }, {rootMargin: "500px"});
  async function show(figure) {
    const {columns, roots, doc} = figures[+figure.dataset.zoom], box = document.createElement("div");
    box.className = columns > 1 ? "live two" : "live";
    const places = Object.fromEntries(roots.map(id => {
      const place = document.createElement("div");
      box.append(place); return [id, place];
    }));
    figure.prepend(box);
    try {
      if (coarse) for (const root of doc.roots) root.attributes.toolbar.attributes.active_drag = null;  // the page scrolls
      const key = "figure" + figure.dataset.zoom;
      await Bokeh.embed.embed_items({[key]: doc}, [{docid: key, roots: places, root_ids: roots}]);
      figure.classList.add("zoomed");
    } catch (error) { box.remove(); console.error(error); }
  }
  for (const figure of document.querySelectorAll("figure[data-zoom]")) seen.observe(figure);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => location.reload());
})();
