// The page's parts put together: the user acts, the server answers, and the answer is drawn.

import { Controls } from "./controls.js";
import { colourBands, colourRefused, paint } from "./layers.js";
import { Link } from "./link.js";
import { MapView } from "./map.js";
import { Profile } from "./profile.js";

const byId = (id) => document.getElementById(id);
let METHODS = []; // the names that the site gives
const STATUS = {
  START_BLOCKED: "The start is impassable: drag it elsewhere",
  GOAL_BLOCKED: "The goal is impassable: drag it elsewhere",
  START_OUTSIDE_MAP: "The start lies outside the map",
  GOAL_OUTSIDE_MAP: "The goal lies outside the map",
  NO_PATH: "There is no path",
};
const LEAVE_COSTS = ["method", "refine", "start", "goal", "via"]; // whatever these are
const MOST_TIMES = 100;
const SETTLES_MS = 250;

const times = []; // from an action to its path drawn, the newest last
const regions = new Map(); // method -> layer
const lines = new Map();
let asked = null; // the question as it stands
let good = null; // the last that was answered
let path = { rows: [], cols: [] };
let controls = null;
let pixels = {};
let optimum = null; // cost of exact A*'s path
let compare = 0; // number of the newest comparison
let timer = null;

const map = new MapView({
  moved: (end, cell, at) => {
    stale();
    if (typeof end === "number") asked.via[end] = cell;
    else asked[end] = cell;
    link.ask("path", {}, { at });
    over(cell);
  },
  turned: (end, heading, at) => {
    stale();
    asked[`${end}_heading_deg`] = heading;
    link.ask("path", {}, { at });
  },
  settled: settle,
  painted: obstacle,
  clicked(cell, { shiftKey, ctrlKey, altKey, metaKey }) {
    over(cell);
    if (ctrlKey || altKey || metaKey) addVia(cell);
    else change({ [shiftKey ? "start" : "goal"]: cell });
  },
  removed: (at) => change({ via: asked.via.filter((_, each) => each !== at) }),
  over,
});
const profile = new Profile((place, heading) => {
  map.cursor(place);
  map.outline(place, asked && controls?.bodies[asked.body].outline, heading);
});
const link = new Link(
  () => asked,
  hear,
  () => tell("The page's server has ended. Start it and load the page again."),
);

const places = new Link(
  () => asked,
  ({ words }) => {
    byId("place").hidden = !pointed || !words;
    byId("place").textContent = words?.join(" · ").replace(/-(?=\d)/g, "−") ?? "";
  },
  () => {},
);
let pointed = null;
document.addEventListener("pointerdown", ({ target }) => target.closest("#map") || over(null));
function over(cell) {
  if (pointed && cell && pointed[0] === cell[0] && pointed[1] === cell[1]) return;
  pointed = cell;
  if (cell) places.ask("place", { at: cell });
  else byId("place").hidden = true;
}

fetch("/opening").then(async (answer) => opening(await answer.json()));

function opening(site) {
  const [rows, cols] = site.shape;
  byId("name").textContent = site.name;
  document.title = `${site.name} – nnpp-edge view`;
  byId("size").textContent = `${rows} × ${cols} cells of ${Number(site.sides_m[0].toPrecision(4))} m`;
  map.open(rows, cols, site.sides_m);
  asked = site.asked;
  controls = new Controls(site, change);
  colourRefused(site.refused.map(({ colour }) => colour));
  byId("refused").replaceChildren(...site.refused.map(swatch));
  putEnds();
  METHODS = Object.keys(site.methods);
  byId("methods").tBodies[0].replaceChildren(...METHODS.map(row));
  const side = Math.ceil(Math.max(map.frame.clientWidth, map.frame.clientHeight) * devicePixelRatio);
  pixels = { pixels: Math.min(Math.max(side, 512), 2048) };
  link.ask("relief", pixels); // seen while kernels are compiled for the first path
  link.ask("path");
  link.ask("cost", pixels);
  settle();
  busy();
  byId("map").removeAttribute("aria-busy");
}

function swatch({ colour, words }) {
  const key = document.createElement("span");
  const patch = key.appendChild(document.createElement("i"));
  patch.style.background = `rgb(${colour})`;
  key.append(words);
  key.hidden = true;
  return key;
}

function putEnds() {
  const { arcs } = controls.bodies[asked.body];
  byId("turns").hidden = !arcs;
  map.putVias(asked.via);
  for (const end of ["start", "goal"]) {
    map.putEnd(end, asked[end]);
    map.putHeading(end, asked[`${end}_heading_deg`] ?? null, arcs);
  }
}

function change(values) {
  stale();
  const same = ([name, value]) => LEAVE_COSTS.includes(name) || (name in asked.limits ? asked.limits : asked)[name] === value;
  const costs = !Object.entries(values).every(same);
  for (const [name, value] of Object.entries(values)) (name in asked.limits ? asked.limits : asked)[name] = value;
  putEnds();
  link.ask("path");
  if (costs) link.ask("cost", pixels);
  settle();
  busy();
}

// A via point comes where the path passes nearest to it; from its button, between the stops that lie farthest apart.
function nearest([row, col]) {
  const away = path.rows.map((each, at) => (each - row) ** 2 + (path.cols[at] - col) ** 2);
  return away.indexOf(Math.min(...away));
}
function addVia(cell) {
  const place = asked.via.filter((each) => nearest(each) < nearest(cell)).length;
  change({ via: asked.via.toSpliced(path.rows.length ? place : asked.via.length, 0, cell) });
}
byId("add-via").addEventListener("click", () => {
  const stops = [0, ...asked.via.map(nearest).sort((a, b) => a - b), path.rows.length - 1];
  const gaps = stops.slice(1).map((stop, at) => stop - stops[at]);
  const middle = stops[gaps.indexOf(Math.max(...gaps))] + (Math.max(...gaps) >> 1);
  addVia(path.rows.length ? [path.rows[middle], path.cols[middle]].map(Math.round) : [map.rows >> 1, map.cols >> 1]);
});

function hear(answer, question) {
  const { want } = question;
  if (want === "file") save(answer);
  else if (answer.problem) refused(answer.problem);
  else if (want === "path") show(answer, question);
  else if (want === "compare") compared(answer, question.more.method);
  else if (want === "reach") reached(answer, question.asked);
  else paint(byId(want), answer.layer);
  if (answer.refused) [...byId("refused").children].forEach((key, at) => (key.hidden = !answer.refused.includes(at + 1)));
  busy();
}

// What is refused leaves everything as it was: so do the controls.
function refused(problem) {
  tell(problem);
  if (!good) return;
  asked = structuredClone(good);
  controls.show(asked);
  putEnds();
}

function show(answer, question) {
  tell("");
  path = answer;
  good = question.asked;
  map.line("path-rim", answer.rows, answer.cols);
  map.line("path", answer.rows, answer.cols);
  map.reverse(answer.rows, answer.cols, answer.gears);
  map.lineOf("grid", answer.grid);
  map.waypoints(answer.waypoints);
  map.obstacles(good.obstacles);
  if (question.kind !== "edit") map.lineOf("before");
  for (const id of ["undo", "clear"]) byId(id).disabled = !good.obstacles.length;
  byId("across").disabled = answer.rows.length < 3;
  if (question.at !== null) requestAnimationFrame(() => drawn(question.at)); // the figures follow the line
  figures(answer);
  profile.show(answer);
  byId("command").textContent = answer.command;
  shadeReach();
}

// What can be reached depends on all of the question but where the path leads.
let reachOf = "";
const reachKey = ({ goal, via, method, refine, goal_heading_deg: heading, ...rest }) => JSON.stringify(rest);
const layer = () => document.querySelector("[name=layer]:checked").value;

function reached({ cells, step, bands, layer: found }, question) {
  reachOf = reachKey(question);
  const key = (colour, at) => {
    const each = document.createElement("span");
    each.appendChild(document.createElement("i")).style.background = colour;
    const most = (at + 1) * step;
    const amount = { s: duration, J: joules }[path.unit]?.(most) ?? Number(most.toPrecision(6)).toLocaleString("en");
    each.append(`${at ? "" : "to "}${amount}`);
    return each;
  };
  const share = `${((100 * cells) / (map.rows * map.cols)).toFixed(1)} % of the map can be reached`;
  byId("bands").replaceChildren(...colourBands(bands).map(key), share + (path.unit ? "" : ", by cost"));
  showLimit();
  paint(byId("reach"), found);
  shadeReach();
}

// A limit of one's own, in a unit that goes with the step cost.
const WITHIN = { s: { min: 60, h: 3600 }, J: { kJ: 1e3, MJ: 1e6, kWh: 3.6e6 } };
const within = () => {
  const amount = Number(byId("within").value) * (WITHIN[path.unit]?.[byId("within-unit").value] ?? 1);
  return amount > 0 ? { within: amount } : {};
};
function showLimit() {
  byId("limit").hidden = layer() !== "reach";
  const units = Object.keys(WITHIN[path.unit] ?? { cost: 1 });
  const select = byId("within-unit");
  if ([...select.options].map(({ value }) => value).join() === units.join()) return;
  select.replaceChildren(...units.map((unit) => new Option(unit)));
}
for (const id of ["within", "within-unit"])
  byId(id).addEventListener("change", () => {
    reachOf = "";
    settle();
    busy();
  });

function shadeReach() {
  byId("reach").hidden = layer() !== "reach" || reachOf !== reachKey(good);
}

function save({ file, content, problem }) {
  byId("copied").textContent = problem ?? "";
  if (problem) return;
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([content])), download: file });
  link.click();
  URL.revokeObjectURL(link.href);
}
for (const button of document.querySelectorAll("[data-format]"))
  button.addEventListener("click", () => link.ask("file", { format: button.dataset.format }));

// After the frame with the path has been drawn.
function drawn(at) {
  const channel = new MessageChannel();
  channel.port1.onmessage = () => {
    times.push(performance.now() - at);
    if (times.length > MOST_TIMES) times.shift();
    const sorted = [...times].sort((a, b) => a - b);
    byId("latency").textContent = `the screen follows in ${Math.round(sorted[sorted.length >> 1])} ms`;
    byId("latency").title = `Median of the last ${times.length}, from the drag to the path on the screen`;
    channel.port1.close();
  };
  channel.port2.postMessage(null);
}

function figures({ figures: found, facts, ok, warnings }) {
  const status = byId("status");
  status.textContent = ok ? `Path found by ${found.method}` : (STATUS[found.status] ?? found.status);
  status.classList.toggle("bad", !ok);
  byId("why").textContent = found.reason || found.choice;
  byId("figures").replaceChildren(
    ...facts.flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]),
  );
  byId("warnings").hidden = !warnings.length;
  byId("warnings").lastElementChild.replaceChildren(...warnings.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
}

const number = (value) => (Math.abs(value) >= 1000 ? value.toFixed(1) : String(Number(value.toPrecision(5))));

function duration(seconds) {
  if (seconds === null) return "unknown";
  if (seconds < 120) return `${seconds.toFixed(0)} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 120) return `${minutes} min`;
  const hours = Math.floor(minutes / 60);
  const rest = (count, unit) => (count ? ` ${count} ${unit}` : "");
  const days = Math.floor(hours / 24).toLocaleString("en");
  return hours < 48 ? `${hours} h${rest(minutes % 60, "min")}` : `${days} days${rest(hours % 24, "h")}`;
}

function joules(energy) {
  return energy < 1e6 ? `${number(energy / 1e3)} kJ` : `${number(energy / 1e6)} MJ (${Number((energy / 3.6e6).toPrecision(3))} kWh)`;
}

function tell(text) {
  byId("notice").hidden = !text;
  byId("notice").textContent = text;
}

let lateBusy = null;
function busy() {
  clearTimeout(lateBusy);
  byId("busy").hidden = true;
  lateBusy = setTimeout(waiting, 300);
}

// What takes long says why: kernels that are compiled, once.
async function waiting() {
  byId("busy").hidden = link.idle;
  byId("busy").textContent ||= "working …";
  if (link.idle) return;
  lateBusy = setTimeout(waiting, 500);
  const { notice } = await (await fetch("/news")).json();
  byId("busy").textContent = notice || "working …";
}

// Methods side by side: one after another once nothing has moved for a while, so that a drag is never kept waiting.

function row(method) {
  const found = document.createElement("tr");
  found.id = `row-${method}`;
  const radio = Object.assign(document.createElement("input"), { type: "radio", name: "shade", value: method, checked: method === "auto" });
  radio.addEventListener("change", shade);
  const label = document.createElement("label");
  label.append(radio, method);
  const cells = [label, "", "", ""].map((content) => {
    const cell = document.createElement("td");
    cell.append(content);
    return cell;
  });
  found.append(...cells);
  return found;
}

const shaded = () => document.querySelector("[name=shade]:checked")?.value;

function shade() {
  const found = regions.get(shaded());
  byId("region").hidden = !found;
  if (found) paint(byId("region"), found);
  map.lineOf("beside", shaded() === byId("method").value ? [] : lines.get(shaded()));
}

function stale() {
  compare += 1;
  clearTimeout(timer);
  byId("methods").classList.add("stale");
  byId("region").hidden = true;
  map.lineOf("beside");
}

function settle() {
  clearTimeout(timer);
  timer = setTimeout(() => {
    if (!link.idle) {
      settle();
      return;
    }
    compare += 1;
    regions.clear();
    lines.clear();
    if (layer() === "reach" && reachOf !== reachKey(asked) && !path.figures?.status.startsWith("START")) link.ask("reach", { ...pixels, ...within() });
    next(compare, ["astar", ...METHODS.filter((method) => method !== "astar")]);
  }, SETTLES_MS);
}

function next(mine, methods) {
  if (mine !== compare) return;
  const method = methods.shift();
  if (!method) {
    byId("methods").classList.remove("stale");
    return;
  }
  link.ask("compare", { method, ...pixels }, { done: () => next(mine, methods) });
}

function compared(answer, method) {
  const { method: by, cost, time_ms: time, status, share, expansions } = answer;
  if (method === "astar") optimum = cost;
  const gap = cost === null || optimum === null ? null : optimum ? (cost - optimum) / Math.abs(optimum) : 0;
  const cells = byId(`row-${method}`).cells;
  cells[1].textContent = cost === null ? "–" : number(cost);
  cells[2].textContent = gap === null ? "–" : `${(100 * gap).toFixed(2)} %`;
  cells[3].textContent = time.toFixed(time < 10 ? 2 : 1);
  const where = share === null ? (asked.via.length ? "leg by leg" : "whole map") : `${(100 * share).toFixed(1)} % of the map`;
  const ended = cost === null ? `${status}, ` : "";
  byId(`row-${method}`).title = `${ended}${method === by ? "" : `${by}: `}${where}, ${expansions.toLocaleString("en")} cells expanded`;
  lines.set(method, answer.line);
  if (answer.layer) regions.set(method, answer.layer);
  if (shaded() === method) shade();
}

byId("paint").addEventListener("click", ({ target }) => {
  map.painting = !map.painting;
  target.setAttribute("aria-pressed", map.painting);
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && map.painting) byId("paint").click();
});
byId("across").addEventListener("click", () => {
  const side = Math.max(Math.round(Math.max(map.rows, map.cols) / 25), 3);
  const middle = path.rows.length >> 1;
  obstacle([Math.round(path.rows[middle]) - (side >> 1), Math.round(path.cols[middle]) - (side >> 1), side, side]);
});
byId("undo").addEventListener("click", () => edit(asked.obstacles.slice(0, -1)));
byId("clear").addEventListener("click", () => edit([]));

function obstacle(part) {
  const [row, col] = [Math.max(part[0], 0), Math.max(part[1], 0)];
  const [rows, cols] = [Math.min(part[0] + part[2], map.rows) - row, Math.min(part[1] + part[3], map.cols) - col];
  if (rows > 0 && cols > 0) edit([...asked.obstacles, [row, col, rows, cols]]);
}

function edit(obstacles) {
  asked.obstacles = obstacles;
  stale();
  map.line("before", path.rows, path.cols);
  link.ask("path", {}, { kind: "edit" });
  link.ask("cost", pixels);
  settle();
  busy();
}

for (const radio of document.querySelectorAll("[name=layer]"))
  radio.addEventListener("change", () => {
    for (const name of ["slope", "cost"]) byId(name).hidden = radio.value !== name;
    shadeReach();
    if (radio.value === "reach") settle();
    byId("opacity").disabled = byId("legend").hidden = radio.value === "relief";
    byId("legend").className = `hint ${radio.value}`;
    byId("most").textContent = radio.value === "slope" ? "40°" : "1";
    byId("least").textContent = radio.value === "slope" ? "0°" : "0";
    byId("brown").hidden = byId("refused").hidden = radio.value !== "cost";
    for (const id of ["least", "ramp", "most"]) byId(id).hidden = radio.value === "reach";
    byId("bands").hidden = radio.value !== "reach";
    showLimit();
    if (radio.value === "slope" && !byId("slope").dataset.asked) {
      byId("slope").dataset.asked = "yes";
      link.ask("slope", pixels);
      busy();
    }
  });
function opacity() {
  const { value } = byId("opacity");
  for (const name of ["slope", "cost", "reach"]) byId(name).style.opacity = value;
  byId("opacity").nextElementSibling.textContent = `${Math.round(100 * value)} %`;
}
byId("opacity").addEventListener("input", opacity);
opacity();

byId("zoom-in").addEventListener("click", () => map.zoomBy(1.5));
byId("zoom-out").addEventListener("click", () => map.zoomBy(1 / 1.5));
byId("zoom-fit").addEventListener("click", () => map.fit());

byId("copy-command").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(path.command);
    byId("copied").textContent = `Copied.${good.obstacles.length ? " It has no painted obstacles." : ""}`;
  } catch {
    byId("copied").textContent = "The browser does not let the page copy: take the text from below.";
    byId("command").closest("details").open = true;
  }
});
