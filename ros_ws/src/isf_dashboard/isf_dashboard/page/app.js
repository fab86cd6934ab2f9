// The page: keeps what the server tells, shows it as it was at one time, and passes pause and stop on.
import { PartScene, colourOf } from "./scene.js";
import { Plot } from "./plots.js";

const $ = (id) => document.getElementById(id);
const KEPT = 40000; // samples; of more, every second one of the older half is let go
const SILENT = 4000; // ms without a message, which comes once a second at least, after which the page says so

const MODES = ["idle", "waiting for a contour", "approach", "building up force", "force control", "position control", "force held", "lifting", "hold"];
const FLAGS = { 16: "contact lost", 32: "force oscillates", 64: "load cell drifted", 128: "no wrenches: the tools stand" };
const MODES_THAT_WAIT = [0, 1, 7, 8];

// -- what is known -------------------------------------------------------------------------------------------------

const known = { mode: "live", status: {}, items: {}, columns: {}, rows: [], width: 1 };
const view = { time: Infinity, follow: true, playing: false, shapeKey: "", pathKey: "", eventKey: "", springbackKey: "" };

function unpacked(value) {
  const bytes = Uint8Array.from(atob(value.data), (char) => char.charCodeAt(0));
  return value.kind === "u1" ? bytes : new Float32Array(bytes.buffer);
}

function begin(told) {
  if (told.part > 0) alertText("");
  known.mode = told.mode;
  known.items = {};
  known.columns = Object.fromEntries(told.columns.map((name, k) => [name, k]));
  known.width = told.columns.length;
  Object.assign(view, { shapeKey: "", pathKey: "", eventKey: "", springbackKey: "" });
  document.body.classList.toggle("recorded", told.mode === "run");
}

function take(item) {
  for (const [name, value] of Object.entries(item)) if (value && value.data !== undefined) item[name] = unpacked(value);
  const list = (known.items[item.kind] ??= []);
  list.push(item);
  if (item.kind === "target") takeTarget(item);
  if (item.kind === "job") scene?.radii(item.radii ?? []);
  if (item.kind === "event" && item.severity === "fault" && known.mode === "live") alertFault(item);
}

function takeSamples(data) {
  const values = unpacked(data);
  for (let k = 0; k + known.width <= values.length; k += known.width) known.rows.push(values.subarray(k, k + known.width));
  if (known.rows.length > KEPT) {
    const half = KEPT / 2;
    known.rows = known.rows.filter((_, k) => k >= half || k % 2 === 0);
  }
}

const all = (kind) => known.items[kind] ?? [];
const until = (kind, time) => all(kind).filter((item) => item.t <= time + 1e-3);
const last = (list) => list[list.length - 1];
const field = (row, name) => (row ? row[known.columns[name]] : NaN);

function rowAt(time) {
  let [low, high] = [0, known.rows.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (known.rows[middle][0] <= time + 1e-4) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

function span() {
  if (known.mode === "run") return [0, known.status.end || 1];
  const first = known.rows.length ? known.rows[0][0] : 0;
  const end = known.rows.length ? last(known.rows)[0] : first + 1;
  return [first, Math.max(end, first + 1)];
}

// -- text ------------------------------------------------------------------------------------------------------------

const number = (value, digits = 1) => (Number.isFinite(value) ? (Number(value.toFixed(digits)) || 0).toFixed(digits).replace("-", "\u2212") : "–");
function clock(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
}

function element(tag, text = "", kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function put(id, text) {
  const place = $(id);
  if (place.textContent !== text) place.textContent = text;
}

// -- the shape ---------------------------------------------------------------------------------------------------------

let scene = null;
let target = null;
try {
  scene = new PartScene($("scene"));
  scene.onTheme = () => { view.shapeKey = ""; };
} catch (error) {
  console.info(`no three-dimensional view: ${error.message}`);
  note("The three-dimensional view needs WebGL, which this browser does not offer.");
}

function note(text) {
  $("scene-note").hidden = !text;
  put("scene-note", text);
}

function takeTarget(item) {
  const [nx, ny] = [item.x.length, item.y.length];
  const angle = new Float32Array(nx * ny).fill(NaN);
  for (let row = 1; row + 1 < ny; row += 1) {
    for (let column = 1; column + 1 < nx; column += 1) {
      const k = row * nx + column;
      const dx = (item.z[k + 1] - item.z[k - 1]) / (item.x[column + 1] - item.x[column - 1]);
      const dy = (item.z[k + nx] - item.z[k - nx]) / (item.y[row + 1] - item.y[row - 1]);
      angle[k] = Math.atan(Math.hypot(dx, dy)) * 180 / Math.PI;
    }
  }
  target = { ...item, angle };
  scene?.grid(item.x, item.y, item.z, item.opening);
  view.shapeKey = "";
}

// Height of the sheet: the wanted shape as far as contours have formed it, and what a scan has seen.
function heights(time, scan) {
  const levels = {};
  const formed = new Set(until("result", time).filter((item) => item.completed).map((item) => item.index));
  for (const contour of all("contour")) {
    if (!formed.has(contour.index)) continue;
    for (const [label, level] of Object.entries(contour.levels)) {
      if (!(label in levels) || Math.abs(level - target.flange) > Math.abs(levels[label] - target.flange)) levels[label] = level;
    }
  }
  const levelled = all("contour").some((contour) => Object.keys(contour.levels).length);
  const z = new Float32Array(target.z.length);
  const reached = new Uint8Array(z.length);
  for (let k = 0; k < z.length; k += 1) {
    const [wanted, label] = [target.z[k], target.opening[k]];
    if (!label || !levelled) {
      z[k] = wanted;
      reached[k] = label && formed.size ? 1 : 0;
    } else if (!(label in levels)) {
      z[k] = target.flange;
    } else {
      const level = levels[label];
      const down = level <= target.flange;
      z[k] = down ? Math.max(wanted, level) : Math.min(wanted, level);
      reached[k] = (down ? wanted >= level : wanted <= level) ? 1 : 0;
    }
    if (scan && Number.isFinite(scan.deviation[k])) z[k] = wanted + scan.deviation[k];
  }
  return [z, reached];
}

function drawShape(time) {
  if (!scene) return;
  if (!target) {
    note("The part is drawn as soon as it is planned.");
    return;
  }
  const scans = until("scan", time);
  const results = until("result", time).length;
  const scan = last(scans);
  const wanted = $("colour").value;
  const colour = wanted === "deviation" && !scan ? "depth" : wanted;
  const key = [scans.length, results, colour, all("contour").length].join();
  if (key === view.shapeKey) return;
  view.shapeKey = key;
  const [z, reached] = heights(time, scan && scan.after >= results - 1 ? scan : null);
  const share = new Float32Array(z.length).fill(NaN);
  let [low, high, map, unit] = [0, 1, "sequence", "mm"];
  if (colour === "deviation") {
    map = "deviation";
    high = Math.max(0.1, quantile(scan.deviation.filter((_, k) => target.opening[k]), 0.98));
    low = -high;
    for (let k = 0; k < z.length; k += 1) if (target.opening[k]) share[k] = (scan.deviation[k] - low) / (high - low);
  } else if (colour === "depth") {
    for (let k = 0; k < z.length; k += 1) high = Math.max(high, Math.abs(target.z[k] - target.flange) || 0);
    for (let k = 0; k < z.length; k += 1) if (target.opening[k]) share[k] = Math.abs(z[k] - target.flange) / high;
  } else {
    [high, unit] = [90, "°"];
    for (let k = 0; k < z.length; k += 1) if (reached[k]) share[k] = target.angle[k] / high;
  }
  scene.surface(z, share, map);
  view.z = z;
  view.pathKey = "";
  const pen = $("scale").getContext("2d");
  for (let k = 0; k < 160; k += 1) {
    pen.fillStyle = `rgb(${colourOf(map, k / 159).map((value) => Math.round(255 * value))})`;
    pen.fillRect(k, 0, 1, 10);
  }
  $("scale-box").hidden = false;
  put("scale-low", colour === "deviation" ? `${number(low, 2)} mm, too low` : "0");
  put("scale-high", colour === "deviation" ? `+${number(high, 2)} mm` : `${number(high, unit === "mm" ? 1 : 0)} ${unit}`);
  note(colour !== wanted ? "Coloured by depth; deviation is known after a scan." : "");
}

function quantile(values, share) {
  const sorted = Array.from(values).filter(Number.isFinite).map(Math.abs).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.floor(share * (sorted.length - 1))] : 1;
}

function drawPaths(time) {
  if (!scene) return;
  const formed = new Set(until("result", time).map((item) => item.index));
  const begun = until("contour", time);
  const key = [formed.size, begun.length, all("contour").length, all("path").length].join();
  if (key === view.pathKey) return;
  view.pathKey = key;
  const of = (contour) => {
    const line = new Float32Array(contour.contact.length + (contour.closed ? 3 : 0));
    line.set(contour.contact);
    if (contour.closed) line.set(contour.contact.subarray(0, 3), contour.contact.length);
    return line;
  };
  const onSheet = (line) => { // where the sheet has come to lie
    if (!view.z) return line;
    const [nx, ny] = [target.x.length, target.y.length];
    for (let k = 0; k < line.length; k += 3) {
      const column = Math.round((line[k] - target.x[0]) / (target.x[1] - target.x[0]));
      const row = Math.round((line[k + 1] - target.y[0]) / (target.y[1] - target.y[0]));
      const z = column >= 0 && column < nx && row >= 0 && row < ny ? view.z[row * nx + column] : NaN;
      if (z > line[k + 2]) line[k + 2] = z;
    }
    return line;
  };
  const contours = all("contour");
  const current = last(begun);
  const tool = contours[0]?.tool ?? 1;
  const whole = all("path").filter((item) => item.tool === tool).slice(-1).map((item) => item.tips);
  scene.path("planned", known.mode === "run" ? contours.filter((item) => !formed.has(item.index)).map(of) : whole, 0.1);
  scene.path("formed", contours.filter((item) => formed.has(item.index)).map(of).map(onSheet), 0.15);
  scene.path("current", current && !formed.has(current.index) ? [onSheet(of(current))] : [], 0.2);
}

// -- plots -------------------------------------------------------------------------------------------------------------

// With zero in sight.
function fromZero(_, low, high) {
  const [bottom, top] = [Math.min(0, low ?? 0), Math.max(0, high ?? 0)];
  const room = 0.08 * (top - bottom) || 1;
  return [bottom < 0 ? bottom - room : 0, top + room];
}

const forcePlot = new Plot($("force-plot"), { x: "time in s", y: "force in N", range: fromZero }, [
  { label: "normal force, tool 2", colour: "--blue" },
  { label: "set-point", colour: "--orange", dash: [6, 4], width: 2 },
  { label: "axial force, tool 1", colour: "--soft", width: 1 },
]);
const springbackPlot = new Plot($("springback-plot"), { x: "contour", y: "mm", range: fromZero, incrs: [1, 2, 5, 10, 20, 50, 100] }, [
  { label: "largest correction", colour: "--blue", points: { show: true, size: 5 } },
  { label: "mean", colour: "--blue", dash: [2, 3] },
  { label: "predicted springback", colour: "--orange", dash: [6, 4], points: { show: true, size: 5 } },
]);

let forceDue = 0;
function drawForces(time, at) {
  if (performance.now() < forceDue && view.follow) return;
  forceDue = performance.now() + 250;
  const from = time - Number($("window").value);
  const first = Math.max(0, rowAt(from));
  const step = Math.max(1, Math.ceil((at - first + 1) / 1500));
  const data = [[], [], [], []];
  for (let k = first; k <= at; k += step) {
    const row = known.rows[k];
    const values = [field(row, "normal_force"), field(row, "set_point"), Math.abs(field(row, "fz1"))];
    data[0].push(row[0]);
    values.forEach((value, series) => data[series + 1].push(Number.isFinite(value) ? value : null));
  }
  forcePlot.show(data);
}

function drawSpringback(time) {
  const corrections = until("correction", time);
  const key = `${corrections.length}`;
  if (key === view.springbackKey) return;
  view.springbackKey = key;
  springbackPlot.show([
    corrections.map((item) => item.index + 1),
    corrections.map((item) => item.largest),
    corrections.map((item) => item.mean),
    corrections.map((item) => item.springback),
  ]);
}

// -- words and numbers -----------------------------------------------------------------------------------------------------

function showProgress(time) {
  const contours = all("contour");
  const count = last(contours)?.count ?? 0;
  const results = until("result", time);
  const formed = new Set(results.filter((item) => item.completed).map((item) => item.index));
  const first = last(all("job"))?.first ?? 0;
  const done = first + [...formed].filter((index) => index >= first).length;
  const current = last(until("contour", time));
  const forming = current && !results.some((item) => item.index === current.index);
  put("contours", !count ? "no part" : forming ? `contour ${current.index + 1} of ${count}` : `${done} of ${count} contours`);
  $("bar").value = count ? done / count : 0;
  let left = "";
  if (count && results.length > 1 && done < count && known.status.busy) {
    const recent = results.slice(-6);
    const each = (last(recent).t - recent[0].t) / (recent.length - 1);
    left = `about ${clock(each * (count - done))} left`;
  } else if (count && done === count) {
    left = "all contours formed";
  }
  put("left", left);
}

function showNumbers(row) {
  const limits = last(all("job"))?.force_limits;
  let tilted = false;
  for (const tool of [1, 2]) {
    const tip = ["x", "y", "z"].map((axis) => field(row, axis + tool));
    const force = ["fx", "fy", "fz"].map((axis) => field(row, axis + tool));
    const angles = ["phi", "theta", "psi"].map((axis) => field(row, axis + tool));
    const there = tip.every(Number.isFinite);
    scene?.place(tool - 1, there ? tip : null, angles);
    put(`tip${tool}`, there ? tip.map((value) => number(value)).join("  ") : "–");
    put(`force${tool}`, force.every(Number.isFinite) ? force.map((value) => number(value, 0)).join("  ") : "–");
    put(`tilt${tool}`, angles.slice(0, 2).every(Number.isFinite) ? angles.slice(0, 2).map((value) => number(value)).join("  ") : "–");
    tilted ||= angles.some((value) => Math.abs(value) > 0.05);
    const load = limits ? Math.max(...force.map((value, axis) => Math.abs(value) / limits[axis])) : NaN;
    $(`load${tool}`).value = Number.isFinite(load) ? load : 0;
    $(`load${tool}`).title = Number.isFinite(load) ? `${number(100 * load, 0)} % of the limit` : "limit not known";
  }
  $("tilt-row").hidden = !tilted;
  const [normal, wanted] = [field(row, "normal_force"), field(row, "set_point")];
  put("normal", Number.isFinite(normal) ? `${number(normal, 0)} N` + (Number.isFinite(wanted) ? ` of ${number(wanted, 0)} N` : "") : "–");
  const feed = field(row, "feed");
  put("feed", Number.isFinite(feed) ? `${number(feed)} mm/s` : "–");
}

function showScan(time) {
  const scan = last(until("scan", time));
  const tolerance = last(all("job"))?.tolerance;
  put("scan", scan ? `${number(scan.mean, 2)} mm mean, ${number(scan.largest, 2)} mm largest (tolerance ${number(tolerance, 2)} mm)` : "–");
}

function showEvents(time) {
  const events = until("event", time).sort((a, b) => a.t - b.t);
  const key = `${events.length}`;
  if (key === view.eventKey) return;
  view.eventKey = key;
  const rows = events.slice(-100).reverse().map((item) => {
    const row = element("li", "", item.severity);
    const word = { fault: "Fault", warning: "Event", note: "Note" }[item.severity] ?? "Note";
    const code = item.severity === "fault" ? ` ${item.code} ${item.name}` : "";
    row.append(element("time", clock(item.t)), element("span", `${word}${code}`, "word"), ` ${item.source ? `${item.source}: ` : ""}${item.text}`);
    return row;
  });
  $("events").replaceChildren(...(rows.length ? rows : [element("li", "nothing so far")]));
}

function showStatus() {
  const status = known.status;
  const job = last(all("job"));
  const name = job?.name ?? status.title;
  put("title", name ? `${name}${job ? ` · ${job.process}` : ""}` : "Forming cell");
  document.title = name ? `${name} – forming cell` : "Forming cell";
  const chips = [];
  const chip = (text, kind = "") => chips.push(element("span", text, kind));
  if (known.mode === "run") {
    chip("recorded part");
    chip(`${status.formed} of ${status.planned} contours formed`, status.formed === status.planned ? "good" : "warn");
  } else if (!link.open) {
    chip("no connection", "bad");
  } else {
    chip(status.heard ? "cell heard" : "no cell heard", status.heard ? "good" : "bad");
    if (status.mode) chip(status.mode.changing ? "mode is changing" : status.mode.word, status.mode.word === "automatic" ? "" : "warn");
    else if (status.nodes?.length) chip(status.busy ? "automatic" : "no part is being formed");
    if (status.machine) chip(`machine: ${status.machine.mode}`, status.machine.faults.length ? "bad" : "");
    if (status.machine && !status.machine.tared) chip("load cells not tared", "warn");
    for (const limit of status.machine?.limits ?? []) chip(`${limit} limit reached`, "warn");
  }
  if (job) {
    chip(!job.simulated ? "real machine" : job.lockstep ? "simulated machine, in lockstep" : "simulated machine");
    chip(job.correction === "none" ? "not corrected" : `correction ${job.correction}`);
  }
  const text = chips.map((item) => item.className + item.textContent).join("|");
  if ($("chips").dataset.text !== text) {
    $("chips").dataset.text = text;
    $("chips").replaceChildren(...chips);
  }
  document.body.classList.toggle("stale", known.mode === "live" && !(link.open && status.heard));
  const paused = Boolean(status.paused);
  $("pause").textContent = paused ? "Resume" : "Pause";
  $("pause").classList.toggle("paused", paused);
  $("pause").disabled = !(link.open && status.ready?.pause);
  $("operator").hidden = known.mode === "run";
  $("nodes-section").hidden = known.mode === "run";
  showHand(status);
  showNodes(status);
}

// -- by hand -------------------------------------------------------------------------------------------------------------

const JOG_PERIOD = 50; // ms; the cell stops a tool of whose button it hears nothing for 150 ms
const jog = { button: null, timer: 0 };

function showHand(status) {
  $("hand-section").hidden = known.mode === "run" || !status.mode;
  if ($("hand-section").hidden) return;
  const { word, changing, text } = status.mode;
  const free = link.open && !changing && !status.busy;
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.classList.toggle("on", button.dataset.mode === word);
    button.setAttribute("aria-pressed", button.dataset.mode === word);
    button.disabled = !free;
  }
  const supply = (status.supply ?? []).map((one) => element("span", one.text, one.wrong ? "bad" : ""));
  $("supply").hidden = !supply.length;
  $("supply").replaceChildren(...supply);
  const armed = free && word === "manual" && Boolean(status.hand?.armed);
  for (const button of document.querySelectorAll("[data-way]")) button.disabled = !armed;
  $("zero").disabled = !(free && (word === "manual" || word === "set-up") && !status.hand?.moving);
  if (!armed && jog.button) letGo();
  put("hand-state", changing ? "changing the mode …" : status.hand?.moving ? "a tool is moving" : "");
  const tip = status.hand?.tips?.[Number($("jog-tool").value) - 1];
  put("hand-tip", armed && tip ? tip.map((value, k) => `${"xyz"[k]} ${value.toFixed(3)}`).join("   ") + " mm" : "");
  put("hand-text", text || status.hand?.text || "");
}

function tellJog(enable) {
  const way = jog.button && enable ? jog.button.dataset.way.split(",").map(Number) : [0, 0, 0];
  const asked = { enable, tool: Number($("jog-tool").value), way, increment: Number($("jog-step").value) };
  const stuck = enable && link.socket?.bufferedAmount > 0; // what waits would move the tool later
  if (link.socket?.readyState === WebSocket.OPEN && !stuck) link.socket.send(JSON.stringify({ jog: asked }));
}

function letGo() {
  clearInterval(jog.timer);
  jog.button?.classList.remove("held");
  jog.button = null;
  tellJog(false);
}

function hold(button) {
  if (jog.button) letGo();
  jog.button = button;
  button.classList.add("held");
  tellJog(true);
  jog.timer = setInterval(() => tellJog(true), JOG_PERIOD);
}

for (const button of document.querySelectorAll("[data-way]")) {
  button.addEventListener("pointerdown", (event) => { if (event.button === 0) hold(button); });
  for (const end of ["pointerup", "pointerleave", "pointercancel", "lostpointercapture", "blur"]) {
    button.addEventListener(end, () => { if (jog.button === button) letGo(); });
  }
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat) hold(button);
  });
  button.addEventListener("keyup", () => { if (jog.button === button) letGo(); });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}
addEventListener("blur", () => { if (jog.button) letGo(); });
document.addEventListener("visibilitychange", () => { if (jog.button) letGo(); });
for (const button of document.querySelectorAll("[data-mode]")) {
  button.addEventListener("click", () => command(`mode_${button.dataset.mode.replace("-", "_")}`));
}
$("zero").addEventListener("click", () => command(`zero_${$("zero-system").value.slice(1)}_${$("jog-tool").value}`));

function showNodes(status) {
  const text = JSON.stringify([status.nodes, status.rates]);
  if ($("nodes").dataset.text === text) return;
  $("nodes").dataset.text = text;
  const rows = (status.nodes ?? []).map((node) => {
    const row = element("tr");
    const bad = node.silent || node.level >= 2;
    const word = node.silent ? "silent" : node.level >= 2 ? "fault" : node.level === 1 ? "warning" : node.state;
    const values = Object.entries(node.values).map(([key, value]) => `${key.replaceAll("_", " ")} ${value}`).join(", ");
    const cell = element("td", node.text === "ok" ? "" : node.text);
    cell.append(element("div", values, "values"));
    row.append(element("td", node.name), element("td", word, bad ? "bad" : "ok"), cell);
    return row;
  });
  $("nodes").tBodies[0].replaceChildren(...rows);
  const rates = Object.entries(status.rates ?? {}).map(([name, rate]) => `${name} ${rate} Hz`);
  put("rates", rates.length ? `Received: ${rates.join(", ")}` : "");
}

function showPhase(row) {
  const status = known.status;
  if (known.mode === "run") return;
  const mode = MODES[field(row, "mode")];
  const flags = Object.entries(FLAGS).filter(([flag]) => field(row, "flags") & flag).map(([, text]) => text);
  let phase = status.busy ? status.phase : "";
  if (status.paused) phase = MODES_THAT_WAIT.includes(field(row, "mode")) || status.phase === "paused" ? "paused" : "pausing after this contour";
  put("phase", [phase, status.heard && status.busy ? mode : "", ...flags].filter(Boolean).join(" · "));
}

// -- operator ------------------------------------------------------------------------------------------------------------

function alertText(text) {
  $("alert").hidden = !text;
  put("alert-text", text);
}

$("seen").addEventListener("click", () => alertText(""));

function alertFault(item) {
  if (Date.now() - link.since < 1500) return; // of before this page was opened; the list has it
  alertText(`${item.code} ${item.name} ${item.source ? `${item.source}: ` : ""}${item.text}`);
}

let answerTimer = 0;
function answer(text) {
  $("answer").hidden = false;
  put("answer", text);
  clearTimeout(answerTimer);
  answerTimer = setTimeout(() => { $("answer").hidden = true; }, 12000);
}

async function command(name) {
  if (known.mode === "run") return;
  const failed = (why) => {
    $("answer").hidden = true;
    alertText(`${name === "stop" ? "Not stopped" : `No ${name}`}: ${why}`);
  };
  try {
    const response = await fetch(`command/${name}`, { method: "POST" });
    const told = await response.json();
    if (told.ok) answer(told.text);
    else failed(told.text);
  } catch {
    failed("the dashboard does not answer. Press the emergency stop of the machine.");
  }
}

function stop() {
  if (jog.button) letGo();
  answer("Stopping …");
  command("stop");
}

$("stop").addEventListener("click", stop);
$("pause").addEventListener("click", () => command(known.status.paused ? "resume" : "pause"));

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const inField = ["INPUT", "SELECT", "BUTTON", "SUMMARY", "A"].includes(event.target.tagName);
  if (known.mode === "live" && !event.repeat && (event.key === "Escape" || ((event.key === "s" || event.key === "S") && event.target.tagName !== "SELECT"))) {
    event.preventDefault();
    stop();
  } else if (event.key === " " && !inField) {
    event.preventDefault();
    if (known.mode === "run") play(!view.playing);
    else if (known.status.paused) $("pause").focus(); // going on takes the button
    else if (!$("pause").disabled && !event.repeat) command("pause");
  }
});

// -- time ----------------------------------------------------------------------------------------------------------------

function play(on) {
  const [first, end] = span();
  if (on && known.mode === "run" && view.time >= end) view.time = first;
  view.playing = on && known.mode === "run";
  view.follow = on && known.mode === "live";
}

$("play").addEventListener("click", () => play(known.mode === "live" ? true : !view.playing));
$("slider").addEventListener("input", () => {
  view.time = Number($("slider").value);
  view.follow = false;
  view.playing = known.mode === "run" && view.playing;
});
for (const id of ["colour", "window"]) $(id).addEventListener("change", () => { view.shapeKey = ""; forceDue = 0; });

let before = performance.now();
function frame(now) {
  const passed = (now - before) / 1000;
  before = now;
  const [first, end] = span();
  if (known.mode === "run") {
    if (view.playing) view.time = Math.min(end, Math.min(view.time, end) + passed * Number($("speed").value));
    if (view.follow) view.time = end; // until it is set
    if (view.time >= end) view.playing = false;
    view.time = Math.min(end, Math.max(first, view.time));
  } else if (view.follow) {
    view.time = end;
  }
  const time = known.mode === "live" && view.follow ? Infinity : view.time;
  const at = known.mode === "live" && view.follow ? known.rows.length - 1 : rowAt(time);
  const row = known.rows[at];
  const slider = $("slider");
  if (document.activeElement !== slider || view.playing || view.follow) {
    slider.min = first;
    slider.max = end;
    slider.value = Math.min(end, view.time);
  }
  put("clock", known.mode === "live" && view.follow ? "now" : known.mode === "live" ? `${clock(end - view.time)} ago` : `${clock(view.time)} of ${clock(end)}`);
  put("play", known.mode === "live" ? "Now" : view.playing ? "Pause" : "Play");
  $("play").disabled = known.mode === "live" && view.follow;
  $("speed-label").hidden = known.mode === "live";
  showProgress(time);
  showNumbers(row);
  showScan(time);
  showEvents(time);
  showPhase(row);
  showStatus();
  drawShape(time);
  drawPaths(time);
  drawForces(Number.isFinite(time) ? time : end, at);
  drawSpringback(time);
  scene?.draw();
}

// As often as news come, and while something moves on the page; a page out of sight does nothing.
let shown = 0;
function tick(now) {
  requestAnimationFrame(tick);
  if (now - shown < 45 && !scene?.dirty) return;
  if (now - shown < 45) {
    scene.draw();
    return;
  }
  shown = now;
  frame(now);
}

// -- connection ------------------------------------------------------------------------------------------------------------

const link = { open: false, heard: 0, since: 0, silent: false };

setInterval(() => {
  if (!link.open || link.silent || performance.now() - link.heard < SILENT) return;
  link.silent = true;
  alertText("No news from the dashboard: what is shown is old. Stop at the machine.");
}, 500);

function connect() {
  const address = new URL("stream", location.href);
  address.protocol = "ws:";
  const socket = new WebSocket(address);
  link.socket = socket;
  socket.onopen = () => {
    link.open = true;
    link.since = Date.now();
    link.heard = performance.now();
    known.rows = [];
    alertText("");
  };
  socket.onmessage = (event) => {
    link.heard = performance.now();
    const told = JSON.parse(event.data);
    if (link.silent) alertText("");
    link.silent = false;
    if (told.begin) begin(told.begin);
    if (told.samples) takeSamples(told.samples);
    if (told.status) known.status = told.status;
    for (const item of told.items ?? []) take(item);
    document.documentElement.dataset.samples = known.rows.length;
    document.documentElement.dataset.results = all("result").length;
  };
  socket.onclose = (event) => {
    const lost = known.mode === "run" ? "" : " What is shown is old. Stop at the machine.";
    if (event.code === 1001) alertText("The dashboard has ended.");
    else if (link.open || !link.since) alertText(`No connection to the dashboard.${lost}`);
    link.open = false;
    link.since ||= 1;
    setTimeout(connect, 1000);
  };
}

put("keys", "Keys: Esc or S stop, Space pause, arrows turn the part");
connect();
requestAnimationFrame(tick);
