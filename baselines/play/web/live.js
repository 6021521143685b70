// A flight that goes on: as a recorded one, but that frames are added to it and old ones are forgotten.
import { Flight } from "./data.js";

const KEPT = 1500; // frames
const EMPTY = { values: new Float32Array(0) };

export class LiveFlight extends Flight {
  // `card` as `baselines/play/flight.py` gives it; `path`: points of the leader's path.
  constructor(card, path) {
    const names = ["ticks", "started", "positions", "attitudes", "slots", "actions", "path"];
    const arrays = Object.fromEntries(names.map((name) => [`0.${name}`, EMPTY]));
    super({ ...card, end: null, failure: null }, 0, arrays);
    const [n, k] = [card.followers, card.entries.length];
    this.widths = { started: 1, positions: 3 * n + 3, attitudes: 4 * n + 4, slots: 3 * n, actions: n * k };
    if (card.laws) this.widths.lyapunov = 4 * n;
    for (const [name, width] of Object.entries(this.widths)) this[name] = new Float32Array(KEPT * width);
    this.path = Float32Array.from(path.flat());
    this.times = [];
    this.last = 0;
  }

  // A frame takes the place of the last one where no time has passed.
  append(frame) {
    if (this.instants === KEPT) this.forget(KEPT / 5);
    const again = this.instants > 0 && frame.time <= this.last;
    const j = again ? this.instants - 1 : this.instants++;
    for (const [name, width] of Object.entries(this.widths)) {
      const row = this[name].subarray(j * width, (j + 1) * width);
      if (frame[name] === null) row.fill(NaN);
      else row.set(name === "started" ? [frame.started] : frame[name]);
    }
    this.times[j] = this.last = frame.time;
    this.end = frame.end;
    this.failure = frame.failure;
  }

  forget(count) {
    for (const [name, width] of Object.entries(this.widths)) this[name].copyWithin(0, count * width);
    this.times.splice(0, count);
    this.instants -= count;
  }

  // What is true now, for a scene.
  now() {
    return this.state(this.last, this.trailing);
  }

  // Root mean square distance of the followers from their slots, m.
  error() {
    const j = this.instants - 1;
    let sum = 0;
    for (let i = 0; i < this.followers; i++) sum += this.between("slots", i, "positions", i + 1, j) ** 2;
    return Math.sqrt(sum / this.followers);
  }
}
