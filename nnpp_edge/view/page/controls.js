// The sliders and choices: what is asked, as the server has it, shown in controls and back.

const byId = (id) => document.getElementById(id);
const degrees = (value) => `${value}°`;
const length = (value) => `${value} m`;

// Sliders of lengths are logarithmic. `hard` ones are off until their box is ticked; `body` ones need a vehicle.
const SLIDERS = [
  { name: "slope_limit_deg", label: "Slope limit φₛ", low: 5, high: 60, step: 1, unit: degrees },
  { name: "hard_slope_deg", label: "Hard slope", low: 5, high: 60, step: 1, unit: degrees, hard: 30 },
  { name: "hard_gradient_deg", label: "Hard single step", low: 5, high: 60, step: 1, unit: degrees, hard: 30 },
  { name: "roughness_limit_m", label: "Roughness rₛ", low: 0.01, high: 100, log: true, unit: length },
  { name: "step_limit_m", label: "Step Hₛ", low: 0.01, high: 100, log: true, unit: length },
  { name: "omega", label: "Weight ω", low: 0, high: 0.05, step: 0.001, unit: String },
  { name: "clearance_m", label: "Clearance", low: 0.02, high: 2, log: true, unit: length, body: true },
  { name: "max_tilt_deg", label: "Max. tilt", low: 5, high: 60, step: 1, unit: degrees, body: true },
];

export class Controls {
  constructor(opening, changed) {
    this.changed = changed; // (values)
    this.bodies = opening.bodies;
    byId("method").replaceChildren(...Object.keys(opening.methods).map((name) => new Option(name, name)));
    byId("step_cost").replaceChildren(...Object.entries(opening.step_costs).map(([name, label]) => new Option(label, name)));
    byId("body").replaceChildren(...Object.keys(this.bodies).map((name) => new Option(name, name)));
    for (const name of ["method", "step_cost", "body"])
      byId(name).addEventListener("change", ({ target }) => {
        this.#fitTo(byId("body").value, byId("step_cost").value);
        const reset = name === "body" ? { clearance_m: null, max_tilt_deg: null, refine: byId("refine").checked } : {};
        if (name === "body") this.#showBody();
        this.changed({ [name]: target.value, step_cost: byId("step_cost").value, ...reset });
      });
    byId("refine").addEventListener("change", ({ target }) => this.changed({ refine: target.checked }));
    byId("sliders").replaceChildren(...SLIDERS.map((slider) => this.#slider(slider)));
    this.show(opening.asked);
  }

  // What is asked, in the controls.
  show(asked) {
    for (const name of ["method", "step_cost", "body"]) byId(name).value = asked[name];
    byId("refine").checked = asked.refine;
    for (const slider of SLIDERS.filter((each) => !each.body)) this.#set(slider, (slider.name in asked.limits ? asked.limits : asked)[slider.name]);
    this.#showBody(asked);
    this.#fitTo(asked.body, asked.step_cost);
  }

  // Time and energy need a vehicle's table; the price of the ground does not count where slopes do.
  #fitTo(body, stepCost) {
    for (const option of byId("step_cost").options) {
      const needed = ["time", "energy"].includes(option.value);
      option.disabled = needed && !this.bodies[body][option.value];
    }
    const choice = byId("step_cost");
    if (choice.selectedOptions[0]?.disabled) choice.value = "paper";
    const poses = this.bodies[body].clearance_m !== null; // its legs lead in 16 directions
    if (poses) byId("refine").checked = false;
    byId("refine").disabled = poses || choice.value !== "paper";
    byId("omega").disabled = choice.value !== "paper";
  }

  #showBody(asked = {}) {
    const body = this.bodies[byId("body").value];
    for (const slider of SLIDERS.filter((each) => each.body)) {
      byId(slider.name).closest(".slider").hidden = body[slider.name] === null;
      if (body[slider.name] !== null) this.#set(slider, asked[slider.name] ?? body[slider.name]);
    }
  }

  #slider(slider) {
    const { name, label, low, high, step, log, hard } = slider;
    const row = document.createElement("div");
    row.className = "slider";
    const range = Object.assign(document.createElement("input"), { type: "range", id: name });
    Object.assign(range, log ? { min: Math.log10(low), max: Math.log10(high), step: 0.02 } : { min: low, max: high, step });
    const output = document.createElement("output");
    output.htmlFor = name;
    const words = Object.assign(document.createElement("label"), { htmlFor: hard ? `${name}-on` : name, textContent: label });
    if (hard) {
      words.prepend(Object.assign(document.createElement("input"), { type: "checkbox", id: `${name}-on` }));
      range.setAttribute("aria-label", label);
    }
    row.append(words, range, output);
    for (const part of row.querySelectorAll("input"))
      part.addEventListener("input", ({ target }) => {
        if (hard && target === range) row.querySelector("[type=checkbox]").checked = true;
        this.changed({ [name]: this.#show(slider, row) });
      });
    return row;
  }

  #set(slider, value) {
    const row = byId(slider.name).closest(".slider");
    const range = byId(slider.name);
    if (slider.hard) byId(`${slider.name}-on`).checked = value !== null;
    const number = value ?? slider.hard;
    range.value = slider.log ? Math.log10(number) : number;
    this.#show(slider, row, number);
  }

  // The value that a slider stands at, null where it is off; and in words beside it.
  #show(slider, row, given = null) {
    const range = byId(slider.name) ?? row.querySelector("[type=range]");
    const raw = given ?? (slider.log ? 10 ** Number(range.value) : Number(range.value));
    const value = Number(raw.toPrecision(slider.log && given === null ? 2 : 6));
    const off = slider.hard && !row.querySelector("[type=checkbox]").checked;
    row.classList.toggle("off", Boolean(off));
    row.querySelector("output").textContent = off ? "any" : slider.unit(value);
    range.setAttribute("aria-valuetext", row.querySelector("output").textContent);
    return off ? null : value;
  }
}
