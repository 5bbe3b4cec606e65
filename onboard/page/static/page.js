// The page of a flight, or of a log. Frames are complete: one that is left out costs nothing but its place in a course.
import {age, clockText, count, rate, unitText, withInterval} from "./format.js";
import {Course, draw, drawing} from "./course.js";
import {Arm} from "./arm.js";
import {Signals} from "./signals.js";
import {Acts} from "./acts.js";

const LATE_MS = 4000, AGAIN_MS = 1500, MOST_EVENTS = 2000, SHOWN_EVENTS = 200, REASONS = 4;
const at = id => document.getElementById(id);
const arm = new Arm(at("arm")), signals = new Signals(), acts = new Acts(), cards = new Map(), courses = new Map();
let flight = null, frame = null, events = [], stream = null, lastMs = 0, again = null;

const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };
const make = (tag, kind = "", text = "") => {
  const node = document.createElement(tag);
  if (kind) node.className = kind;
  node.textContent = text;
  return node;
};
const broken = text => text.replace(/([._+])(?=[a-z])/gi, "$1\u200b");  // names may go on in the next line after a mark
// As many children as there are items, each filled; those that are there are used again.
function fill(parent, items, born, update) {
  while (parent.children.length > items.length) parent.lastChild.remove();
  while (parent.children.length < items.length) parent.append(born());
  items.forEach((item, i) => update(parent.children[i], item));
}

function link(text, kind) {
  put(at("link"), text);
  at("link").className = `link ${kind}`;
  document.body.classList.toggle("stale", kind === "lost");
}

// ---- what is shown

function show(next) {
  frame = next;
  document.title = `${next.go.word} ${next.title}`;
  put(at("title"), broken(next.title));
  put(at("time"), `T+ ${clockText(next.t)}`);
  put(at("phase"), next.phase);
  put(at("mode"), next.mode);
  const worst = ["against", "open"].find(kind => next.go.reasons.some(reason => reason.kind === kind)) ?? "go";
  put(at("word"), next.go.word);
  at("word").className = `word ${next.go.word === "GO" ? "go" : worst}`;
  const order = ["against", "open", "note"], reasons = [...next.go.reasons].sort((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind));
  const tell = (id, those) => fill(at(id), those, () => make("li"), (node, reason) => { put(node, reason.text); node.className = reason.kind; });
  const split = reasons.length > REASONS ? REASONS - 1 : REASONS;
  tell("reasons", reasons.slice(0, split));
  tell("further-reasons", reasons.slice(split));
  at("further").hidden = reasons.length <= split;
  put(at("further-count"), `${reasons.length - split} more reasons`);
  answers(next);
  health(next);
  arm.show(next.joints, next.held, flight.live);
  signals.show(next.t);
}

function answers(next) {
  const kinds = ["mass", "centre", "inertia", "other"];
  const sorted = [...next.held].sort((a, b) => kinds.indexOf(a.kind) - kinds.indexOf(b.kind));
  at("nothing").hidden = sorted.some(one => one.kind !== "other");
  at("more").hidden = !sorted.some(one => one.kind === "other");
  const known = new Set(sorted.map(one => one.name));
  for (const [name, card] of cards) if (!known.has(name)) { card.box.remove(); cards.delete(name); }
  for (const one of sorted) answer(one, next.t);
  at("asked").hidden = !next.asked;
  if (next.asked) put(at("asked"), asked(next.asked));
}

function asked(one) {
  const ratio = one.ratio === null ? "" : `; the widest interval is ${one.ratio.toPrecision(3)} times what is wanted`;
  const then = one.expected === null ? "" : `, ${one.expected.toPrecision(3)} expected after it`;
  return `Asked for: ${one.act}${one.segment ? ` ${one.segment}` : ""}${ratio}${then}`;
}

function answer(one, now) {
  if (!cards.has(one.name)) cards.set(one.name, card(one));
  const its = cards.get(one.name), half = Math.max(one.high - one.value, one.value - one.low);
  const told = one.supported && one.value !== null && one.low !== null && one.high !== null;
  put(its.level, one.level);
  its.level.className = `level ${one.level === "do not use" ? "not" : one.level}`;
  its.number.className = told ? "number" : "number none";
  its.number.dataset.value = told ? one.value : "";
  its.number.dataset.low = told ? one.low : "";
  its.number.dataset.high = told ? one.high : "";
  const course = courses.get(one.name) ?? new Course();
  courses.set(one.name, course);
  if (told && flight.live) course.add([now, one.value, one.low, one.high]);
  const points = flight.live ? course.points : course.until(now), none = points.length ? "no longer determined" : "not determined yet";
  const [value, interval] = told ? withInterval(one.value, half) : [one.level === "do not use" ? one.level : none, ""];
  put(its.value, value);
  put(its.interval, told ? ` ${interval} ${unitText(one.unit)}` : "");
  its.interval.title = told ? `95 %: ${one.low.toPrecision(6)} to ${one.high.toPrecision(6)}; 99.9 %: ${one.low_999?.toPrecision(6)} to ${one.high_999?.toPrecision(6)}` : "";
  const plan = told && flight.plan[one.name];
  its.plan.hidden = !plan;
  if (plan) put(its.plan, `plan ${withInterval(one.value, plan.half, Math.max(Math.abs(one.value), half))[1]} ${unitText(plan.unit)}`);
  put(its.why, broken(one.why));
  its.why.hidden = !one.why;
  its.why.title = one.why;
  draw(its.course, points, now);
}

function card(one) {
  const box = make("article", "answer"), head = make("h3"), number = make("div", "number");
  const its = {box, number, level: make("span", "level"), value: make("span"), interval: make("small"), plan: make("small", "plan"), why: make("p", "why"), course: drawing()};
  box.dataset.name = one.name;
  its.why.tabIndex = 0;
  head.append(make("span", "", broken(one.name)), its.level);
  its.plan.title = "half of the 95 % interval that the plan expects at its end";
  number.append(its.value, its.interval, its.plan);
  box.append(head, number, its.course.box, its.why);
  at(one.kind === "other" ? "others" : "held").append(box);
  return its;
}

function health(next) {
  const box = next.computer, over = next.ended || ["safe", "stopped"].includes(next.mode);  // then silence is no fault
  put(at("status"), box ? `status ${box.status}${box.before ? ` (before: ${box.before})` : ""}` : flight.live ? "" : "this log has no health records");
  at("devices").closest("table").hidden = !next.devices.length;
  fill(at("devices"), next.devices, () => {
    const row = make("tr");
    row.append(make("td"), make("td", "n"), make("td", "n"), make("td", "n"), make("td"));
    return row;
  }, (row, one) => {
    const [name, hz, missing, last, clock] = row.children;
    row.dataset.name = one.name;
    row.dataset.rows = one.rows;
    put(name, broken(one.name));
    put(hz, one.nominal_hz ? `${rate(one.rate_hz)} / ${rate(one.nominal_hz)}` : one.rate_hz ? rate(one.rate_hz) : "-");
    const slow = !over && one.nominal_hz && one.rate_hz !== null && one.rate_hz < 0.9 * one.nominal_hz;
    hz.className = slow ? (one.rate_hz === 0 ? "n bad" : "n warn") : "n";
    put(missing, one.missing ? `${count(one.missing)} in ${count(one.gaps)}` : "-");
    missing.className = one.missing ? "n warn" : "n";
    put(last, age(one.age_s));
    put(clock, one.clock === null ? "-" : one.sigma_us === null ? one.clock : `${one.clock} \u00b1${age(1e-6 * one.sigma_us).replace(" ", "\u00a0")}`);
    clock.className = over ? "" : one.clock === "invalid" ? "bad" : one.clock === "flywheel" ? "warn" : "";
  });
  at("processes-box").hidden = !next.processes.length;
  const across = (name, tag, texts) => fill(at(`process-${name}`), texts, () => make(tag, "n"), put);
  across("name", "th", ["process", ...next.processes.map(one => one.name)]);
  across("cpu", "td", ["CPU %", ...next.processes.map(one => one.cpu_percent === null ? "-" : one.cpu_percent.toFixed(1))]);
  across("pss", "td", ["PSS MB", ...next.processes.map(one => one.pss_mb === null ? "-" : one.pss_mb.toFixed(0))]);
  put(at("computer"), box ? computer(box) : "");
}

function computer(box) {
  const number = (value, digits, unit) => value === null || value === undefined ? null : `${value.toFixed(digits)}${unit}`;
  return [
    box.computer_idle_percent === null ? null : `CPU ${number(box.computer_idle_percent, 0, " % idle")}`,
    box.disk_free_mb === null ? null : `disk ${number(box.disk_free_mb / 1024, 1, " GB free")}`,
    box.memory_free_mb === null ? null : `memory ${number(box.memory_free_mb / 1024, 1, " GB free")}`,
    box.temperature_deg_c === null ? "temperature unknown" : number(box.temperature_deg_c, 0, " \u00b0C"),
    box.estimator_lag_s === null ? null : `estimator ${age(box.estimator_lag_s)} behind`,
    box.recorder_backlog_percent === null ? null : `fullest ring ${number(box.recorder_backlog_percent, 0, " %")}`,
    box.not_recorded ? `${count(box.not_recorded)} rows not recorded` : null,
    box.restarts ? `${count(box.restarts)} restarts of workers` : null,
  ].filter(Boolean).join(", ");
}

let listed = "";
function list() {
  const words = at("search").value.toLowerCase().split(/\s+/).filter(Boolean), now = flight && !flight.live && frame ? frame.t : Infinity;
  const found = events.filter(one => one.t <= now && (!at("warnings").checked || one.severity > 0)
    && words.every(word => `${one.source} ${one.code} ${one.text}`.toLowerCase().includes(word)));
  const shown = found.sort((a, b) => a.t - b.t || a.n - b.n).slice(-SHOWN_EVENTS).reverse(), key = `${found.length} ${shown[0]?.n} ${words} ${flight?.title}`;
  if (key === listed) return;
  listed = key;
  put(at("shown"), `${count(found.length)} of ${count(frame?.event_count ?? events.length)}${found.length > shown.length ? `, the last ${SHOWN_EVENTS} shown` : ""}`);
  fill(at("events"), shown, () => {
    const row = make("li");
    row.append(make("span", "at"), make("span", "source"), make("span", "text"));
    return row;
  }, (row, one) => {
    row.className = `s${Math.min(one.severity, 2)}`;
    put(row.children[0], `${one.t.toFixed(3)} s`);
    put(row.children[1], one.source || one.code);
    put(row.children[2], one.text);
  });
}

// ---- where it comes from

async function begin() {
  clearTimeout(again);
  stream?.close();
  try {
    const response = await fetch("flight", {cache: "no-store"});
    if (!response.ok) throw new Error(`${response.status}`);
    flight = await response.json();
  } catch {
    link("no connection: trying again", "lost");
    again = setTimeout(begin, AGAIN_MS);
    return;
  }
  events = flight.events;
  listed = "";
  courses.clear();
  for (const [name, points] of Object.entries(flight.history)) courses.set(name, new Course(points));
  for (const card of cards.values()) card.box.remove();
  cards.clear();
  arm.begin(flight.arm, flight.meshes);
  signals.begin(flight);
  acts.begin(flight.acts);
  put(at("title"), broken(flight.title));
  at("player").hidden = flight.live;
  if (flight.live) follow(); else played();
}

function follow() {
  const mine = stream = new EventSource(`live?since=${events.length ? events.at(-1).n + 1 : 0}`);
  lastMs = performance.now();
  stream.onmessage = message => {
    lastMs = performance.now();
    const next = JSON.parse(message.data);
    if (next.title !== flight.title) { begin(); return; }  // the flight that was waited for
    events.push(...next.events);
    if (events.length > MOST_EVENTS) events = events.slice(-MOST_EVENTS);
    show(next);
    list();
    const slow = next.skipped ? `; ${count(next.skipped)} frames left out: this connection is slow` : "";
    const lost = next.lost ? `; ${count(next.lost)} rows came too fast for the page (the log has them)` : "";
    if (next.ended) { link("the flight has ended", "over"); acts.end(); ended(mine); }
    else if (!next.devices.length && !next.event_count && !next.held.length) link("waiting for the flight to begin", "slow");
    else link(`live${slow}${lost}`, slow || lost ? "slow" : "ok");
  };
  stream.onerror = () => {
    mine.close();
    if (stream !== mine) return;
    link("no connection: trying again", "lost");
    clearTimeout(again);
    again = setTimeout(begin, AGAIN_MS);
  };
}

// The last numbers stay; a new flight at this address takes their place.
function ended(mine) {
  mine.close();
  stream = null;
  const look = async () => {
    try {
      if ((await fetch("flight", {cache: "no-store"})).ok) { begin(); return; }
    } catch { /* not yet */ }
    again = setTimeout(look, 2 * AGAIN_MS);
  };
  again = setTimeout(look, 2 * AGAIN_MS);
}

setInterval(() => {
  if (stream && performance.now() - lastMs > LATE_MS) {
    link(`nothing has come for ${age((performance.now() - lastMs) / 1e3)}: trying again`, "lost");
    lastMs = performance.now();
    begin();
  }
}, 1000);

// ---- a log

let wanted = -1, busy = false, playing = 0;
function played() {
  link("log", "ok");
  at("slider").max = flight.steps.length - 1;
  at("slider").value = flight.steps.length - 1;
  want(flight.steps.length - 1);
}

async function want(number) {
  wanted = number;
  if (busy) return;
  busy = true;
  let got = -1;
  while (wanted !== got) {
    got = wanted;
    try {
      const response = await fetch(`frame/${got}`);
      if (!response.ok) throw new Error(`${response.status}`);
      show(await response.json());
      list();
      link("log", "ok");
    } catch {
      link("no connection: heft watch has ended", "lost");
      stop();
      break;
    }
  }
  busy = false;
}

function stop() { clearInterval(playing); playing = 0; put(at("play"), "play"); }

at("slider").oninput = () => { stop(); want(+at("slider").value); };
at("play").onclick = () => {
  if (playing) { stop(); return; }
  put(at("play"), "stop");
  const steps = flight.steps, last = steps.length - 1;
  if (+at("slider").value >= last) at("slider").value = 0;
  let time = steps[+at("slider").value];
  playing = setInterval(() => {
    time += 0.1 * +at("speed").value;
    let number = +at("slider").value;
    while (number < last && steps[number + 1] <= time) number += 1;
    if (number !== +at("slider").value) { at("slider").value = number; want(number); }
    if (number >= last) stop();
  }, 100);
};
at("player").onsubmit = event => event.preventDefault();
at("search").oninput = list;
at("warnings").onchange = () => { listed = ""; list(); };
begin();
