// What `baselines/replay/packing.py` has packed, and flights made of it.

// Bytes of base64 text.
function bytesOf(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

// Bytes of deflated bytes in base64.
export async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Arrays by name: { rows, columns, values }, values row after row.
export function unpacked(bytes, blocks) {
  const arrays = {};
  let at = 0;
  for (const { name, rows, columns, step } of blocks) {
    const count = rows * columns;
    const values = new Float32Array(count);
    for (let column = 0; column < columns; column++) {
      let sum = 0;
      for (let row = 0; row < rows; row++) {
        const k = at + column * rows + row;
        const folded =
          bytes[k] | (bytes[k + count] << 8) | (bytes[k + 2 * count] << 16) | (bytes[k + 3 * count] << 24);
        sum += (folded >>> 1) ^ -(folded & 1);
        values[row * columns + column] = sum * step;
      }
    }
    arrays[name] = { rows, columns, values };
    at += 4 * count;
  }
  return arrays;
}

// A flight: its card (see `page._card`) with arrays, and what follows from them.
export class Flight {
  constructor(card, number, arrays) {
    Object.assign(this, card);
    const of = (name) => arrays[`${number}.${name}`];
    this.vehicles = card.followers + 1;
    this.times = of("ticks").values.map((tick) => tick * card.period);
    this.instants = this.times.length;
    this.last = this.times[this.instants - 1];
    for (const name of ["started", "positions", "attitudes", "slots", "actions", "path"]) {
      this[name] = of(name).values;
    }
    this.lyapunov = of("lyapunov") ? of("lyapunov").values : null;
    const first = this.started.indexOf(1);
    this.trailing = this.trailSeconds();
    this.trigger = first > 0 ? this.times[first] : null;
  }

  // How long trails are, s: as far as four times the formation's size, at the leader's mean speed.
  trailSeconds() {
    const n = 3 * this.vehicles;
    let way = 0;
    for (let j = 1; j < this.instants; j++) {
      const k = n * j;
      way += Math.hypot(...[0, 1, 2].map((axis) => this.positions[k + axis] - this.positions[k - n + axis]));
    }
    const speed = way / Math.max(this.last, 1e-6);
    return Math.min(6, Math.max(1.2, (4 * Math.max(...this.offsets)) / Math.max(speed, 1e-6)));
  }

  // Index of the last instant that is not later than t.
  index(t) {
    let low = 0;
    let high = this.instants - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // Row `j` of an array with `width` numbers in each.
  row(name, j, width) {
    return this[name].subarray(j * width, (j + 1) * width);
  }

  // What scene.show takes, between two instants by straight lines; `seconds` is the length of the trail.
  state(t, seconds) {
    const j = this.index(t);
    const next = Math.min(j + 1, this.instants - 1);
    const span = this.times[next] - this.times[j];
    const share = span > 0 ? Math.min(1, Math.max(0, (t - this.times[j]) / span)) : 0;
    const n = this.vehicles;
    const mixed = (name, width) => {
      const a = this.row(name, j, width);
      const b = this.row(name, next, width);
      return a.map((x, k) => x + share * (b[k] - x));
    };
    const positions = mixed("positions", 3 * n);
    const trail = [];
    const from = this.index(t - seconds);
    const stride = Math.max(1, Math.round((j - from) / 120));
    for (let k = from - (from % stride); k <= j; k += stride) trail.push(this.row("positions", k, 3 * n));
    trail.push(positions);
    return {
      time: t,
      started: this.started[j] > 0.5,
      ended: t >= this.last && this.end !== null,
      failure: t >= this.last ? this.failure : null,
      positions,
      attitudes: mixed("attitudes", 4 * n),
      slots: mixed("slots", 3 * (n - 1)),
      trail,
    };
  }

  // Distance of each follower from its slot at each instant, follower by follower, m.
  errors() {
    return this.overFollowers((j, i) => this.between("slots", i, "positions", i + 1, j));
  }

  // Distance to the nearest other vehicle, m.
  separations() {
    return this.overFollowers((j, i) => {
      let least = Infinity;
      for (let other = 0; other < this.vehicles; other++) {
        if (other !== i + 1) least = Math.min(least, this.between("positions", i + 1, "positions", other, j));
      }
      return least;
    });
  }

  // Distance to the leader, m.
  leaderDistances() {
    return this.overFollowers((j, i) => this.between("positions", i + 1, "positions", 0, j));
  }

  // An entry of the actions.
  commands(entry) {
    const k = this.entries.length;
    return this.overFollowers((j, i) => this.actions[(j * this.followers + i) * k + entry]);
  }

  // One of the Lyapunov functions.
  lyapunovs(which) {
    return this.overFollowers((j, i) => 10 ** this.lyapunov[(j * this.followers + i) * 4 + which]);
  }

  overFollowers(of) {
    return Array.from({ length: this.followers }, (_, i) =>
      Float32Array.from({ length: this.instants }, (_, j) => of(j, i)),
    );
  }

  between(name, i, other, k, j) {
    const a = this[name];
    const b = this[other];
    const p = 3 * (j * (name === "slots" ? this.followers : this.vehicles) + i);
    const q = 3 * (j * this.vehicles + k);
    return Math.hypot(a[p] - b[q], a[p + 1] - b[q + 1], a[p + 2] - b[q + 2]);
  }
}
