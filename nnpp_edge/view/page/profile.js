// Height and cost along the path, and a cursor that marks the place on the map.

const byId = (id) => document.getElementById(id);
const WIDE = 1000;
const HIGH = 150;
const COST_HIGH = 36;

export class Profile {
  constructor(pointAt) {
    this.pointAt = pointAt; // (row, col) or null, and a heading
    this.at = null;
    const chart = byId("chart");
    chart.addEventListener("pointermove", (event) => this.#point(event));
    chart.addEventListener("pointerdown", (event) => this.#point(event));
    chart.addEventListener("pointerleave", () => this.#mark(null));
    chart.addEventListener("blur", () => this.#mark(null));
    chart.addEventListener("keydown", (event) => {
      const last = (this.path?.rows.length ?? 0) - 1;
      if (last < 1) return;
      const far = Math.max(Math.round(last / 50), 1);
      const now = this.at ?? 0;
      const to = { ArrowRight: now + far, ArrowLeft: now - far, ArrowUp: now + far, ArrowDown: now - far, Home: 0, End: last }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      this.#mark(Math.min(Math.max(to, 0), last));
    });
  }

  show(path) {
    this.path = path.distance_m?.length > 1 ? path : null;
    for (const id of ["height-area", "height-line", "cost-area"]) byId(id).setAttribute("d", "");
    byId("reading-range").textContent = "";
    for (const tick of byId("axis-heights").children) tick.textContent = "";
    byId("axis-distance").replaceChildren();
    this.#mark(null);
    if (!this.path) return;
    const { distance_m: distance, height_m: heights, cost } = path;
    const length = distance.at(-1) || 1;
    const known = heights.filter((height) => height !== null);
    const low = Math.min(...known);
    const high = Math.max(...known);
    const x = distance.map((each) => ((WIDE * each) / length).toFixed(1));
    if (known.length) {
      const scale = (HIGH - COST_HIGH - 14) / Math.max(high - low, 0.5);
      const line = heights.map((height, at) => `${at ? "L" : "M"}${x[at]} ${(HIGH - COST_HIGH - 6 - (height - low) * scale).toFixed(1)}`).join("");
      byId("height-line").setAttribute("d", line);
      byId("height-area").setAttribute("d", `${line}L${WIDE} ${HIGH - COST_HIGH}L0 ${HIGH - COST_HIGH}Z`);
      const [top, bottom] = byId("axis-heights").children;
      top.textContent = metres(Math.max(high, low + 0.5));
      bottom.textContent = metres(low);
      byId("reading-range").textContent = "height above, cost 0 to 1 below";
    }
    byId("axis-distance").replaceChildren(
      ...[0, 0.25, 0.5, 0.75, 1].map((share) => Object.assign(document.createElement("span"), { textContent: metres(share * length) })),
    );
    const area = cost.map((each, at) => `L${x[at]} ${(HIGH - COST_HIGH * each).toFixed(1)}`).join("");
    byId("cost-area").setAttribute("d", `M0 ${HIGH}${area}L${WIDE} ${HIGH}Z`);
    byId("chart").setAttribute("aria-valuemax", distance.length - 1);
  }

  #point(event) {
    if (!this.path) return;
    const { left, width } = byId("chart").getBoundingClientRect();
    const { distance_m: distance } = this.path;
    const wanted = ((event.clientX - left) / width) * distance.at(-1);
    let low = 0;
    let high = distance.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (distance[middle] < wanted) low = middle + 1;
      else high = middle;
    }
    this.#mark(low);
  }

  #mark(at) {
    this.at = at;
    const line = byId("at");
    line.toggleAttribute("hidden", at === null);
    if (at === null || !this.path) {
      byId("reading-at").textContent = "";
      this.pointAt(null);
      return;
    }
    const { rows, cols, distance_m: distance, height_m: heights, cost } = this.path;
    const x = (WIDE * distance[at]) / (distance.at(-1) || 1);
    line.setAttribute("x1", x);
    line.setAttribute("x2", x);
    const { tilt_deg: tilts, clearance_m: clearances, heading_deg: headings } = this.path;
    const stands = tilts ? ` · tilt ${tilts[at].toFixed(1)}°${clearances?.[at] == null ? "" : ` · clear by ${clearances[at].toFixed(2)} m`}` : "";
    const text = `${metres(distance[at])} · height ${heights[at] === null ? "unknown" : metres(heights[at])} · cost ${cost[at].toFixed(2)}${stands}`;
    byId("reading-at").textContent = text;
    byId("chart").setAttribute("aria-valuenow", at);
    byId("chart").setAttribute("aria-valuetext", text);
    this.pointAt([rows[at], cols[at]], headings?.[at]);
  }
}

function metres(length) {
  const far = Math.abs(length) >= 10000;
  const number = far ? (length / 1000).toFixed(2) : length.toFixed(Math.abs(length) < 100 ? 1 : 0);
  return `${number.replace("-", "−")} ${far ? "km" : "m"}`;
}
