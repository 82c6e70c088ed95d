// Questions to the server: they go out one after another, and of a kind that repeats only the newest waits.

export class Link {
  // `asked` gives the question as it stands when it goes out; `hear` gets its answer.
  constructor(asked, hear, lost) {
    Object.assign(this, { asked, hear, lost });
    this.waiting = new Map(); // kind -> question
    this.idle = true;
  }

  // `at` is when the user acted, where that is to be timed; `done` is called unless the question is refused.
  ask(want, more = {}, { kind = want, at = null, done = null } = {}) {
    this.waiting.set(kind, { want, more, kind, at, done });
    if (this.idle) this.#run();
  }

  async #run() {
    this.idle = false;
    while (this.waiting.size) {
      const [question] = this.waiting.values();
      this.waiting.delete(question.kind);
      question.asked = structuredClone(this.asked());
      let answer;
      try {
        answer = await this.#answer(question);
      } catch {
        this.waiting.clear();
        this.lost();
        break;
      }
      this.hear(answer, question);
      if (!answer.problem) question.done?.();
    }
    this.idle = true;
  }

  // A line of JSON, then the pixels of a layer, or a file.
  async #answer({ want, more, asked }) {
    const body = JSON.stringify({ want, asked, ...more }, (_, value) => value ?? undefined); // what is off is left out
    const response = await fetch("/ask", { method: "POST", body });
    if (!response.ok) throw new Error(response.statusText);
    const bytes = new Uint8Array(await response.arrayBuffer());
    const end = bytes.indexOf(10);
    const answer = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
    if (answer.layer) answer.layer = { rows: answer.layer[0], cols: answer.layer[1], pixels: bytes.subarray(end + 1) };
    if (answer.file) answer.content = bytes.subarray(end + 1);
    return answer;
  }
}
