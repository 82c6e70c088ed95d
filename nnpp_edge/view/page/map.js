// The map on the screen: where it lies, its lines and ends, and what the pointer does on it.

const MOST_ZOOM = 40;
const RIM = 44; // pixels of a heading's arrow beyond an end
const byId = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";

export class MapView {
  // `act` has moved(end, cell, at), turned(end, degrees, at), settled(), painted(rectangle), clicked(cell, event),
  // removed(via) and over(cell or null). An end is "start", "goal", or the number of a via point.
  constructor(act) {
    this.act = act;
    this.frame = byId("map");
    this.sheet = byId("sheet");
    this.ends = { start: byId("start"), goal: byId("goal") };
    this.arrows = { start: byId("start-heading"), goal: byId("goal-heading") };
    this.cells = {};
    this.zoom = 1;
    this.middle = [0.5, 0.5]; // of the sheet, as shares, in the frame's middle
    for (const end of ["start", "goal"]) this.#watchEnd(end);
    this.#watchArrows();
    this.#watchFrame();
    new ResizeObserver(() => this.place()).observe(this.frame);
  }

  open(rows, cols, [height, width]) {
    Object.assign(this, { rows, cols, sides: [height, width], aspect: (cols * width) / (rows * height) });
    byId("drawing").setAttribute("viewBox", `-0.5 -0.5 ${cols} ${rows}`);
    this.place();
  }

  place() {
    if (!this.rows) return;
    const { clientWidth: wide, clientHeight: high } = this.frame;
    // the arrows of headings reach beyond the map's edge
    const rim = this.zoom === 1 && Object.values(this.arrows).some((arrow) => !arrow.hidden) ? 2 * RIM : 0;
    const width = Math.min(wide - rim, (high - rim) * this.aspect) * this.zoom;
    const height = width / this.aspect;
    const keep = (length, frame, share) => {
      const first = frame / 2 - share * length;
      return length <= frame ? (frame - length) / 2 : Math.min(0, Math.max(frame - length, first));
    };
    this.box = { left: keep(width, wide, this.middle[0]), top: keep(height, high, this.middle[1]), width, height };
    this.middle = [(wide / 2 - this.box.left) / width, (high / 2 - this.box.top) / height];
    for (const [name, value] of Object.entries(this.box)) this.sheet.style[name] = `${value}px`;
    this.frame.classList.toggle("zoomed", this.zoom > 1);
    this.#scale();
  }

  // A bar of a round length, at most a fifth of the frame.
  #scale() {
    const metre = this.box.width / (this.cols * this.sides[1]);
    const most = this.frame.clientWidth / 5 / metre;
    const decade = 10 ** Math.floor(Math.log10(most));
    const length = Math.max(...[1, 2, 5].map((times) => times * decade).filter((each) => each <= most));
    byId("scale").hidden = false;
    byId("scale").firstElementChild.style.width = `${length * metre}px`;
    byId("scale").lastElementChild.textContent = length < 1000 ? `${length} m` : `${length / 1000} km`;
  }

  // A body, metres long and wide or of a radius, at a place in a heading; none hides it.
  outline(place = null, body = null, degrees = 0) {
    let d = "";
    if (place && body) {
      const turn = (degrees * Math.PI) / 180;
      const shape = body.radius_m
        ? Array.from({ length: 24 }, (_, at) => [body.radius_m * Math.cos(at / 3.82), body.radius_m * Math.sin(at / 3.82)])
        : [[1, 0], [1, -1], [-1, -1], [-1, 1], [1, 1], [1, 0], [0, 0], [1, 0]].map(([ahead, left]) => [(ahead * body.length_m) / 2, (left * body.width_m) / 2]);
      d = shape
        .map(([ahead, left], at) => {
          const down = -ahead * Math.cos(turn) - left * Math.sin(turn);
          const right = ahead * Math.sin(turn) - left * Math.cos(turn);
          return `${at ? "L" : "M"}${place[1] + right / this.sides[1]} ${place[0] + down / this.sides[0]}`;
        })
        .join("");
    }
    byId("outline").setAttribute("d", `${d}${d && "Z"}`);
  }

  zoomBy(factor, event = null) {
    const zoom = Math.min(Math.max(this.zoom * factor, 1), MOST_ZOOM);
    if (event) {
      const { left, top, width, height } = this.sheet.getBoundingClientRect();
      const at = [(event.clientX - left) / width, (event.clientY - top) / height];
      this.middle = this.middle.map((share, axis) => at[axis] + ((share - at[axis]) * this.zoom) / zoom);
    }
    this.zoom = zoom;
    this.place();
  }

  fit() {
    this.zoom = 1;
    this.place();
  }

  cellAt({ clientX, clientY }) {
    const { left, top, width, height } = this.sheet.getBoundingClientRect();
    return this.#inside([((clientY - top) / height) * this.rows, ((clientX - left) / width) * this.cols].map(Math.floor));
  }

  #holds({ clientX, clientY }) {
    const { left, top, right, bottom } = this.sheet.getBoundingClientRect();
    return clientX >= left && clientX < right && clientY >= top && clientY < bottom;
  }

  #inside([row, col]) {
    return [Math.min(Math.max(row, 0), this.rows - 1), Math.min(Math.max(col, 0), this.cols - 1)];
  }

  put(element, [row, col]) {
    element.style.left = `${(100 * (col + 0.5)) / this.cols}%`;
    element.style.top = `${(100 * (row + 0.5)) / this.rows}%`;
  }

  putEnd(end, cell) {
    this.cells[end] = cell;
    this.put(this.ends[end], this.#inside(cell));
    if (this.arrows[end]) this.put(this.arrows[end], this.#inside(cell));
    const name = { start: "Start", goal: "Goal" }[end] ?? `Via point ${end + 1}`;
    this.ends[end].setAttribute("aria-label", `${name}, row ${cell[0]}, column ${cell[1]}`);
  }

  // Buttons stay while they are dragged.
  putVias(cells) {
    for (let at = cells.length; this.ends[at]; at++) {
      this.ends[at].remove();
      delete this.ends[at];
    }
    cells.forEach((cell, at) => {
      if (!this.ends[at]) {
        this.ends[at] = Object.assign(document.createElement("button"), { className: "end via", type: "button", textContent: at + 1 });
        this.ends[at].setAttribute("aria-describedby", "keys");
        byId("start").before(this.ends[at]);
        this.ends[at].addEventListener("dblclick", () => this.act.removed(at));
        this.#watchEnd(at);
      }
      this.putEnd(at, cell);
    });
  }

  // Degrees clockwise from up the rows; null for any.
  putHeading(end, heading, shown = true) {
    const arrow = this.arrows[end];
    if (arrow.hidden === shown) {
      arrow.hidden = !shown;
      this.place();
    }
    arrow.classList.toggle("any", heading === null);
    arrow.style.setProperty("--turn", `${heading ?? 0}deg`);
    arrow.setAttribute("aria-label", `${end === "start" ? "Start" : "Goal"} heading, ${heading === null ? "any" : `${heading}°`}`);
    arrow.heading = heading;
  }

  // The parts of a line that are driven backwards.
  reverse(rows, cols, gears = []) {
    let d = "";
    for (let at = 1; at < gears.length; at++)
      if (gears[at] < 0) d += `${at > 1 && gears[at - 1] < 0 ? "" : `M${cols[at - 1]} ${rows[at - 1]}`}L${cols[at]} ${rows[at]}`;
    byId("reverse").setAttribute("d", d);
  }

  line(id, rows, cols) {
    let d = "";
    for (let at = 0; at < rows.length; at++) d += `${at ? "L" : "M"}${cols[at]} ${rows[at]}`;
    byId(id).setAttribute("d", d);
  }

  lineOf(id, cells = []) {
    this.line(id, cells.map((cell) => cell[0]), cells.map((cell) => cell[1]));
  }

  obstacles(parts) {
    byId("obstacles").replaceChildren(...parts.map((part) => this.#rectangle(document.createElementNS(SVG, "rect"), part)));
  }

  waypoints(points = []) {
    byId("waypoints").replaceChildren(
      ...points.slice(1, -1).map((point) => {
        const dot = document.createElement("i");
        this.put(dot, point);
        return dot;
      }),
    );
  }

  cursor(place) {
    const dot = byId("cursor");
    dot.hidden = !place;
    if (place) this.put(dot, place);
  }

  set painting(on) {
    this.frame.classList.toggle("painting", on);
  }

  get painting() {
    return this.frame.classList.contains("painting");
  }

  #rectangle(element, [row, col, rows, cols]) {
    for (const [name, value] of Object.entries({ x: col - 0.5, y: row - 0.5, width: cols, height: rows })) element.setAttribute(name, value);
    return element;
  }

  // `moved` gets where the middle of a button is dragged to, and when.
  #watchPointer(button, moved) {
    let held = null;
    button.addEventListener("pointerdown", (event) => {
      if (this.painting) return; // to the map below
      event.stopPropagation();
      const { left, top, width, height } = button.getBoundingClientRect();
      held = [event.clientX - left - width / 2, event.clientY - top - height / 2];
      button.setPointerCapture(event.pointerId);
    });
    button.addEventListener("pointermove", (event) => {
      if (held) moved({ clientX: event.clientX - held[0], clientY: event.clientY - held[1] }, event.timeStamp);
    });
    for (const name of ["pointerup", "pointercancel"])
      button.addEventListener(name, () => {
        if (held) this.act.settled();
        held = null;
      });
  }

  #watchEnd(end) {
    const button = this.ends[end];
    this.#watchPointer(button, (place, at) => this.#move(end, this.cellAt(place), at));
    button.addEventListener("focus", () => this.#bringIn(end));
    button.addEventListener("keydown", (event) => {
      if (["Delete", "Backspace"].includes(event.key) && typeof end === "number") this.act.removed(end);
      const way = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
      if (!way) return;
      event.preventDefault();
      const far = event.shiftKey ? Math.max(Math.round(Math.max(this.rows, this.cols) / 40), 2) : 1;
      this.#move(end, this.#inside(this.cells[end].map((at, axis) => at + far * way[axis])), event.timeStamp);
      this.#bringIn(end);
      this.act.settled();
    });
  }

  #watchArrows() {
    for (const [end, arrow] of Object.entries(this.arrows)) {
      const turn = (heading, at) => {
        if (heading === arrow.heading) return;
        this.putHeading(end, heading);
        this.act.turned(end, heading, at);
      };
      const whole = (degrees) => (Math.round(degrees) + 360) % 360;
      this.#watchPointer(arrow, ({ clientX, clientY }, at) => {
        const { left, top, width, height } = this.ends[end].getBoundingClientRect();
        turn(whole((Math.atan2(clientX - left - width / 2, top + height / 2 - clientY) * 180) / Math.PI), at);
      });
      arrow.addEventListener("dblclick", (event) => {
        turn(null, event.timeStamp);
        this.act.settled();
      });
      arrow.addEventListener("keydown", (event) => {
        const by = { ArrowLeft: -5, ArrowRight: 5, Delete: null, Backspace: null }[event.key];
        if (by === undefined) return;
        event.preventDefault();
        turn(by === null ? null : whole((arrow.heading ?? 0) + by), event.timeStamp);
        this.act.settled();
      });
    }
  }

  // An end that is selected by keys is brought into view.
  #bringIn(end) {
    const [x, y] = [(this.cells[end][1] + 0.5) / this.cols, (this.cells[end][0] + 0.5) / this.rows];
    const { left, top, width, height } = this.box;
    const at = [left + x * width, top + y * height];
    if (at[0] >= 0 && at[1] >= 0 && at[0] <= this.frame.clientWidth && at[1] <= this.frame.clientHeight) return;
    this.middle = [x, y];
    this.place();
  }

  #move(end, cell, at) {
    if (cell[0] === this.cells[end][0] && cell[1] === this.cells[end][1]) return;
    this.putEnd(end, cell);
    this.act.moved(end, cell, at);
  }

  #watchFrame() {
    const rubber = byId("rubber");
    let first = null;
    let pulled = null;
    let clicked = null; // where the pointer went down, as long as it stays there
    const onMap = ({ target }) => !target.closest("#zoom");
    const spanned = (event) => {
      const [r0, c0] = first;
      const [r1, c1] = this.cellAt(event);
      return [Math.min(r0, r1), Math.min(c0, c1), Math.abs(r1 - r0) + 1, Math.abs(c1 - c0) + 1];
    };
    this.frame.addEventListener("pointerdown", (event) => {
      if (!onMap(event) || event.button) return;
      clicked = this.painting ? null : [event.clientX, event.clientY];
      if (this.painting) first = this.cellAt(event);
      else if (this.zoom > 1) pulled = [event.clientX, event.clientY];
      else return;
      this.frame.setPointerCapture(event.pointerId);
    });
    this.frame.addEventListener("pointermove", (event) => {
      this.act.over(onMap(event) && this.#holds(event) ? this.cellAt(event) : null);
      if (clicked && Math.hypot(event.clientX - clicked[0], event.clientY - clicked[1]) > 4) clicked = null;
      if (first) {
        rubber.hidden = false;
        this.#rectangle(rubber, spanned(event));
      } else if (pulled) {
        const { width, height } = this.box;
        this.middle[0] -= (event.clientX - pulled[0]) / width;
        this.middle[1] -= (event.clientY - pulled[1]) / height;
        pulled = [event.clientX, event.clientY];
        this.place();
      }
    });
    for (const name of ["pointerup", "pointercancel"])
      this.frame.addEventListener(name, (event) => {
        if (first && name === "pointerup") this.act.painted(this.#widened(spanned(event)));
        if (clicked && name === "pointerup" && this.#holds(event)) this.act.clicked(this.cellAt(event), event);
        first = pulled = clicked = null;
        rubber.hidden = true;
      });
    this.frame.addEventListener("pointerleave", ({ pointerType }) => pointerType === "mouse" && this.act.over(null));
    this.frame.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && this.zoom === 1 && event.deltaY > 0) return; // the page scrolls
        event.preventDefault();
        this.zoomBy(Math.exp(-event.deltaY / 400), event);
      },
      { passive: false },
    );
  }

  // A click, or a stroke thinner than a fiftieth of the map, paints a square of that side.
  #widened([row, col, rows, cols]) {
    const least = Math.max(Math.round(Math.max(this.rows, this.cols) / 50), 3);
    const grow = (first, length) => (length >= least ? [first, length] : [first - Math.floor((least - length) / 2), least]);
    const [[top, high], [left, wide]] = [grow(row, rows), grow(col, cols)];
    return [top, left, high, wide];
  }
}
