// Where a scene is looked at from: one orbit for all views, moved by mouse, touch and keys.
import * as THREE from "three";

const FIELD = 34; // degrees, vertical
const START = { azimuth: -0.62, elevation: 0.4, zoom: 1 };
const DRAG = 0.0065; // rad per pixel
const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

export class Orbit {
  // `changed` is called after every movement.
  constructor(element, changed) {
    this.changed = changed;
    this.pointers = new Map();
    this.reset();
    const on = (name, act) => element.addEventListener(name, act, { passive: false });
    on("pointerdown", (event) => this.down(element, event));
    on("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      on(name, (event) => this.pointers.delete(event.pointerId));
    }
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => {
      event.preventDefault();
      this.magnify(Math.exp(-0.0012 * event.deltaY * (event.deltaMode ? 30 : 1)));
    });
  }

  reset() {
    Object.assign(this, START, { pan: [0, 0, 0] });
    this.changed();
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = clamp(this.elevation + elevation, 0.03, 1.55);
    this.changed();
  }

  magnify(factor) {
    this.zoom = clamp(this.zoom * factor, 0.02, 30);
    this.changed();
  }

  // By pixels on the screen: to the right and down.
  shift(x, y) {
    const metres = (this.distance ?? 5) * 0.0011;
    const [s, c] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    // Right is (c, s) in (east, north), away from the viewer (-s, c).
    this.pan[1] -= metres * (x * c + y * s);
    this.pan[0] -= metres * (x * s - y * c);
    this.changed();
  }

  down(element, event) {
    element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  move(event) {
    const own = this.pointers.get(event.pointerId);
    if (!own) return;
    const before = this.spread();
    const [x, y] = [event.clientX - own.x, event.clientY - own.y];
    own.x = event.clientX;
    own.y = event.clientY;
    if (this.pointers.size > 1) {
      const after = this.spread();
      if (before > 0) this.magnify(after / before);
      this.shift(x / this.pointers.size, y / this.pointers.size);
    } else if (event.buttons === 2 || event.shiftKey) {
      this.shift(x, y);
    } else {
      this.turn(-DRAG * x, DRAG * y);
    }
  }

  // Distance between the first two fingers, pixels.
  spread() {
    const [a, b] = this.pointers.values();
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  }

  // Put a camera where a ball of `radius` m around `target` (north, east, down) fits into a view of `width` and
  // `height` pixels below the topmost `inset`; returns its distance from it.
  place(camera, target, radius, width, height, inset) {
    const half = THREE.MathUtils.degToRad(FIELD / 2);
    const narrow = Math.atan((Math.tan(half) * Math.min(height - inset, width)) / height);
    const distance = radius / Math.sin(narrow) / this.zoom;
    this.distance = distance;
    const [north, east, down] = target.map((x, k) => x + this.pan[k]);
    const level = Math.cos(this.elevation);
    camera.position.set(
      east + distance * level * Math.sin(this.azimuth),
      Math.max(-down + distance * Math.sin(this.elevation), 0.05),
      -north + distance * level * Math.cos(this.azimuth),
    );
    camera.fov = FIELD;
    camera.aspect = width / height;
    camera.setViewOffset(width, height, 0, -inset / 2, width, height);
    camera.near = distance / 60;
    camera.far = distance * 40;
    camera.lookAt(east, -down, -north);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    return distance;
  }
}

// What keys do that a replay and the live page share: turning, zooming, following, the theme, help.
export function sharedKeys(orbit, setFollow, theme, help) {
  return {
    "+": () => orbit?.magnify(1.2),
    "=": () => orbit?.magnify(1.2),
    "-": () => orbit?.magnify(1 / 1.2),
    a: () => orbit?.turn(-0.12, 0),
    d: () => orbit?.turn(0.12, 0),
    w: () => orbit?.turn(0, 0.08),
    s: () => orbit?.turn(0, -0.08),
    r: () => orbit?.reset(),
    f: () => setFollow("formation"),
    p: () => setFollow("path"),
    l: () => setFollow("0"),
    t: () => theme.toggle(),
    h: help,
    "?": help,
  };
}
