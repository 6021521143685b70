// Pushing a vehicle, as seen from the camera, and losing a follower.
import { vehicleName } from "./colours.js";

const find = (id) => document.getElementById(id);

// Direction (north, east, down) of a push to the right, away from the viewer and up, seen from an azimuth.
export function direction(right, away, up, azimuth) {
  const [s, c] = [Math.sin(azimuth), Math.cos(azimuth)];
  return [right * s + away * c, right * c - away * s, -up];
}

const WAYS = { left: [-1, 0, 0], right: [1, 0, 0], away: [0, 1, 0], near: [0, -1, 0], up: [0, 0, 1], down: [0, 0, -1] };

export class Pushing {
  // `send(command)` and `azimuth()` are called.
  constructor(send, azimuth) {
    Object.assign(this, { send, azimuth });
    for (const name of Object.keys(WAYS)) find(`push-${name}`).addEventListener("click", () => this.push(name));
    find("strength").addEventListener("input", () => this.showStrength());
    find("lose").addEventListener("click", () => this.lose());
    this.showStrength();
  }

  showStrength() {
    find("strength-value").textContent = `${Number(find("strength").value).toFixed(1)} m/s`;
  }

  // The vehicles to choose from; the same one stays chosen.
  setFollowers(count) {
    const old = find("vehicle").value || "1";
    const names = Array.from({ length: count }, (_, i) => new Option(vehicleName(i + 1), String(i + 1)));
    find("vehicle").replaceChildren(...names, new Option("leader", "0"));
    find("vehicle").value = Number(old) <= count ? old : String(count);
    find("lose").disabled = count < 2;
  }

  push(name) {
    const strength = Number(find("strength").value);
    const change = direction(...WAYS[name], this.azimuth()).map((x) => x * strength);
    this.send({ do: "push", vehicle: Number(find("vehicle").value), change });
  }

  lose() {
    const follower = Number(find("vehicle").value);
    if (follower > 0) this.send({ do: "lose", follower });
  }
}
