// The page's parts put together: the user acts, the server answers, and the answer is drawn.

import { Controls } from "./controls.js";
import { paint } from "./layers.js";
import { Link } from "./link.js";
import { MapView } from "./map.js";
import { metres, Profile } from "./profile.js";

const byId = (id) => document.getElementById(id);
const METHODS = ["auto", "astar", "corridor", "nnpp"];
const STATUS = {
  START_BLOCKED: "The start is impassable: drag it elsewhere",
  GOAL_BLOCKED: "The goal is impassable: drag it elsewhere",
  START_OUTSIDE_MAP: "The start lies outside the map",
  GOAL_OUTSIDE_MAP: "The goal lies outside the map",
  NO_PATH: "There is no path",
};
const MOST_TIMES = 100;
const SETTLES_MS = 250;

const times = []; // from an action to its path drawn, the newest last
const regions = new Map(); // method -> layer
const lines = new Map();
let path = null;
let controls = null;
let compare = 0; // number of the newest comparison
let timer = null;
let finished = false;

const map = new MapView({
  moved: (end, cell, at) => {
    stale();
    link.ask({ type: "move", end, to: cell }, { kind: `move ${end}`, at });
  },
  settled: settle,
  painted: obstacle,
});
const profile = new Profile((place) => map.cursor(place));
const link = new Link(hear, () => {
  if (!finished) tell("The page's server has ended, or this tab was one too many. Start it and load the page again.");
});

window.addEventListener("pagehide", () => (finished = true));
link.opened.then(() => {
  const side = Math.ceil(Math.max(map.frame.clientWidth, map.frame.clientHeight) * devicePixelRatio);
  link.ask({ type: "open", pixels: Math.max(side, 512) });
});

function hear(answer, question) {
  if (answer.type !== "problem" && question) tell("");
  ({ opening, path: show, layer, compared, mended, problem })[answer.type](answer, question);
  busy();
}

function opening(answer) {
  const [rows, cols] = answer.shape;
  byId("name").textContent = answer.name;
  document.title = `${answer.name} – nnpp-edge view`;
  byId("size").textContent = `${rows} × ${cols} cells of ${Number(answer.sides_m[0].toPrecision(4))} m`;
  map.open(rows, cols, answer.sides_m);
  controls = new Controls(answer, (values, at) => {
    stale();
    link.ask({ type: "change", values }, { kind: `change ${Object.keys(values)}`, at });
    settle();
  });
  byId("methods").tBodies[0].replaceChildren(...METHODS.map(row));
  byId("map").removeAttribute("aria-busy");
}

function layer(answer) {
  const [name, method] = answer.name.split(" ");
  if (name !== "region") {
    paint(byId(name), answer);
    return;
  }
  regions.set(method, answer);
  if (shaded() === method) shade();
}

function show(answer, question) {
  path = answer;
  map.line("path-rim", answer.rows, answer.cols);
  map.line("path", answer.rows, answer.cols);
  map.lineOf("grid", answer.grid);
  map.waypoints(answer.waypoints);
  map.obstacles(answer.obstacles);
  for (const end of ["start", "goal"]) if (!dragging(end)) map.putEnd(end, answer[end]);
  if (!question?.message.type.match("paint|mend|undo")) map.lineOf("before");
  for (const id of ["undo", "clear"]) byId(id).disabled = !answer.obstacles.length;
  byId("across").disabled = answer.rows.length < 3;
  requestAnimationFrame(() => drawn(question)); // the figures follow the line
  figures(answer);
  profile.show(answer);
  byId("command").textContent = answer.command;
  byId("python").textContent = answer.python;
  if (question?.message.type === "open") settle();
}

const dragging = (end) => byId(end).matches(":active") || link.waiting.has(`move ${end}`);

// After the frame with the path has been drawn.
function drawn(question) {
  if (!["move", "change"].includes(question?.message.type)) return;
  const channel = new MessageChannel();
  channel.port1.onmessage = () => {
    if (question.message.type === "move") {
      times.push(performance.now() - question.at);
      if (times.length > MOST_TIMES) times.shift();
      const sorted = [...times].sort((a, b) => a - b);
      byId("latency").textContent = `path follows in ${Math.round(sorted[sorted.length >> 1])} ms`;
      byId("latency").title = `Median of the last ${times.length}, from the drag to the path on the screen`;
    }
    channel.port1.close();
  };
  channel.port2.postMessage(null);
}

function figures({ figures: found, ok, unit, on_foot: onFoot, distance_m: distance, warnings }) {
  const status = byId("status");
  status.textContent = ok ? `Path found by ${found.method}` : (STATUS[found.status] ?? found.status);
  status.classList.toggle("bad", !ok);
  status.title = found.reason || found.choice;
  const rows = [];
  if (ok) {
    rows.push(["cost", `${number(found.cost)}${unit && ` ${unit}`}`], ["length", metres(distance.at(-1))]);
    if (found.line_cost !== null && found.line_cost !== undefined) rows.push(["line integral", number(found.line_cost)]);
    if (found.climb_m !== null) {
      rows.push(["climb, descent", `${metres(found.climb_m)}, ${metres(found.descent_m)}`]);
      rows.push(["steepest up, down", `${found.steepest_up_deg.toFixed(1)}°, ${found.steepest_down_deg.toFixed(1)}°`]);
      rows.push([onFoot ? "time on foot" : "time", duration(found.time_s)]);
    }
    if (found.energy_j !== null) rows.push(["energy", `${number(found.energy_j / 1000)} kJ`]);
  }
  rows.push(["planned in", `${(found.timings_ms.total ?? 0).toFixed(1)} ms`], ["cells expanded", found.expansions.toLocaleString("en")]);
  byId("figures").replaceChildren(
    ...rows.flatMap(([name, value]) => [
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
  return minutes < 120 ? `${minutes} min` : `${Math.floor(minutes / 60).toLocaleString("en")} h ${minutes % 60} min`;
}

function tell(text) {
  byId("notice").hidden = !text;
  byId("notice").textContent = text;
}

// What is refused leaves everything as it was: so do the controls.
function problem({ text }, question) {
  tell(text);
  if (question?.message.type === "change" && path) controls.show(path.asked);
}

let lateBusy = null;
function busy() {
  clearTimeout(lateBusy);
  byId("busy").hidden = true;
  if (!link.idle) lateBusy = setTimeout(() => (byId("busy").hidden = link.idle), 300);
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
    next(compare, [...METHODS]);
  }, SETTLES_MS);
}

function next(mine, methods) {
  if (mine !== compare) return;
  const method = methods.shift();
  if (!method) {
    byId("methods").classList.remove("stale");
    return;
  }
  link.ask({ type: "compare", method }, { kind: "compare", done: () => next(mine, methods) });
}

function compared(answer) {
  const { method, by, cost, gap, time_ms: time, status, share, expansions } = answer;
  const cells = byId(`row-${method}`).cells;
  cells[1].textContent = cost === null ? "–" : number(cost);
  cells[2].textContent = gap === null ? "–" : `${(100 * gap).toFixed(2)} %`;
  cells[3].textContent = time.toFixed(time < 10 ? 2 : 1);
  const where = share === null ? "whole map" : `${(100 * share).toFixed(1)} % of the map`;
  const ended = cost === null ? `${status}, ` : "";
  byId(`row-${method}`).title = `${ended}${method === by ? "" : `${by}: `}${where}, ${expansions.toLocaleString("en")} cells expanded`;
  lines.set(method, answer.line);
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
byId("undo").addEventListener("click", () => edit({ type: "undo" }));
byId("clear").addEventListener("click", () => edit({ type: "undo", all: true }));

function obstacle(part) {
  const [row, col] = [Math.max(part[0], 0), Math.max(part[1], 0)];
  const [rows, cols] = [Math.min(part[0] + part[2], map.rows) - row, Math.min(part[1] + part[3], map.cols) - col];
  if (rows > 0 && cols > 0) edit({ type: "paint", part: [row, col, rows, cols] });
}

function edit(message) {
  stale();
  map.line("before", path.rows, path.cols);
  byId("mended").textContent = "…";
  link.ask(message, { done: (answer) => answer.type === "path" && link.ask({ type: "mend" }, { kind: "mend" }) });
  settle();
  busy();
}

function mended({ footing, mended: own, afresh }) {
  const words = { blocked: "The path was blocked", valid: "The path stood", "": "There was no path" }[footing] ?? `The path: ${footing}`;
  const took = ({ ms, expansions }) => `${ms.toFixed(2)} ms, ${expansions.toLocaleString("en")} cells`;
  byId("mended").textContent =
    own.ms === null ? `${words}. ${STATUS[own.status] ?? own.status}.` : `${words}. D* Lite mends it in ${took(own)}; A* afresh takes ${took(afresh)}.`;
}

for (const radio of document.querySelectorAll("[name=layer]"))
  radio.addEventListener("change", () => {
    for (const name of ["slope", "cost"]) byId(name).hidden = radio.value !== name;
    byId("opacity").disabled = byId("legend").hidden = radio.value === "relief";
    byId("legend").className = `hint ${radio.value}`;
    byId("most").textContent = radio.value === "slope" ? "40°" : "1";
    byId("least").textContent = radio.value === "slope" ? "0°" : "0";
    byId("brown").hidden = radio.value === "slope";
    if (radio.value === "slope" && !byId("slope").dataset.asked) {
      byId("slope").dataset.asked = "yes";
      link.ask({ type: "layer", name: "slope" });
      busy();
    }
  });
function opacity() {
  const { value } = byId("opacity");
  for (const name of ["slope", "cost"]) byId(name).style.opacity = value;
  byId("opacity").nextElementSibling.textContent = `${Math.round(100 * value)} %`;
}
byId("opacity").addEventListener("input", opacity);
opacity();

byId("zoom-in").addEventListener("click", () => map.zoomBy(1.5));
byId("zoom-out").addEventListener("click", () => map.zoomBy(1 / 1.5));
byId("zoom-fit").addEventListener("click", () => map.fit());

for (const what of ["command", "python"])
  byId(`copy-${what}`).addEventListener("click", async () => {
    const without = what === "command" && path.obstacles.length ? " It has no painted obstacles: the Python has." : "";
    try {
      await navigator.clipboard.writeText(path[what]);
      byId("copied").textContent = `Copied.${without}`;
    } catch {
      byId("copied").textContent = "The browser does not let the page copy: take the text from below.";
      byId(what).closest("details").open = true;
    }
  });
