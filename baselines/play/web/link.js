// The connection to the server: commands and their answers, messages, and trying again when it is gone.

const AGAIN = 1500; // ms

export class Link {
  // `received(message)` and `connected(whether)` are called.
  constructor(received, connected) {
    Object.assign(this, { received, connected });
    this.waiting = new Map(); // answers that are to come, by number
    this.queued = new Map(); // by what they set: the latest value that has not been sent yet
    this.number = 0;
    this.open();
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/socket`);
    this.socket.addEventListener("open", () => this.connected(true));
    this.socket.addEventListener("message", (event) => this.take(JSON.parse(event.data)));
    this.socket.addEventListener("close", () => {
      this.connected(false);
      this.waiting.forEach((resolve) => resolve({ error: "the server does not answer" }));
      this.waiting.clear();
      setTimeout(() => this.open(), AGAIN);
    });
  }

  take(message) {
    if (message.type !== "answer") {
      this.received(message);
      return;
    }
    this.waiting.get(message.id)?.(message);
    this.waiting.delete(message.id);
  }

  // The last frames have been drawn: the server sends what is new since.
  drawn() {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send("drawn");
  }

  // The answer to a command.
  send(command) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ error: "the server does not answer" });
    this.number += 1;
    const id = this.number;
    this.socket.send(JSON.stringify({ ...command, id }));
    return new Promise((resolve) => this.waiting.set(id, resolve));
  }

  // The same for what is sent often, as a slider moves: one at a time for each `key`, values between are left out.
  async sendLatest(key, command, answered) {
    const busy = this.queued.has(key);
    this.queued.set(key, [command, answered]);
    if (busy) return;
    while (this.queued.get(key)) {
      const [next, done] = this.queued.get(key);
      this.queued.set(key, null);
      done(await this.send(next));
    }
    this.queued.delete(key);
  }
}
