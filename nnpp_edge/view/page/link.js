// The WebSocket to the server: questions go out one after another, and of a kind that repeats only the newest waits.

export class Link {
  constructor(hear, lost) {
    this.number = 0;
    this.waiting = new Map(); // kind -> what is to be sent once the question of that kind has been answered
    this.asked = new Map(); // number -> {kind, at, done}
    this.socket = new WebSocket(`ws://${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("close", lost);
    let announced = null;
    this.socket.addEventListener("message", ({ data }) => {
      if (data instanceof ArrayBuffer) {
        hear({ ...announced, pixels: new Uint8Array(data) });
        return;
      }
      const answer = JSON.parse(data);
      if (answer.type === "layer") announced = answer;
      else hear(answer, this.asked.get(answer.number));
      this.#answered(answer);
    });
    this.opened = new Promise((done) => this.socket.addEventListener("open", done));
  }

  // `at` is when the user acted; a question of the same `kind` that is still waiting is dropped for this one.
  ask(message, { kind = null, at = performance.now(), done = null } = {}) {
    const question = { message, kind, at, done };
    if (kind && [...this.asked.values()].some((each) => each.kind === kind)) this.waiting.set(kind, question);
    else this.#send(question);
  }

  get idle() {
    return this.asked.size === 0;
  }

  #send(question) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.number += 1;
    this.asked.set(this.number, question);
    this.socket.send(JSON.stringify({ ...question.message, number: this.number }));
  }

  #answered(answer) {
    const question = this.asked.get(answer.number);
    if (!question || answer.type === "opening") return; // the path follows
    this.asked.delete(answer.number);
    question.done?.(answer);
    const next = this.waiting.get(question.kind);
    if (next) {
      this.waiting.delete(question.kind);
      this.#send(next);
    }
  }
}
