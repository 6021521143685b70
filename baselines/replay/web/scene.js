// The 3-D scene: a stage draws one or more views into one canvas, all seen from the same side.
//
//   const stage = stageOrNotice(changed);             // null where there is no WebGL
//   const view = stage.addView(element, followers);   // `element` lies over the canvas and is its place;
//                                                     // a part of it with `data-inset` keeps its room
//   view.setPath(points);                             // the leader's path, north east down north east ...
//   view.show(state); stage.render();
//
// A state is one moment: `positions` and `attitudes` (w x y z) of all vehicles, leader first, `slots`,
// `trail`, a list of earlier positions, the oldest first, `time` (s), which turns the rotors, and `failure`,
// null or a number for each follower that is not 0 where it has failed. Inertial frame north-east-down, m.
import * as THREE from "three";
import { colourOf, palette } from "./colours.js";
import { Orbit } from "./camera.js";
import { ARM, Floor, Quadrotor, Shadow, Slot } from "./models.js";
import { Ribbon } from "./ribbons.js";

const TRAIL = 160; // points
const LABELLED = 40; // vehicles, at most
const SMALLEST = 0.005; // of the distance, an arm that is drawn larger than it is

// The stage of a page, or null and a notice where there is no WebGL.
export function stageOrNotice(changed) {
  const find = (id) => document.getElementById(id);
  try {
    return new Stage(find("canvas"), changed);
  } catch {
    find("no-webgl").hidden = false;
    find("compass").hidden = true;
    find("stage").classList.add("flat");
    return null;
  }
}

class Stage {
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "low-power" });
    this.renderer.setScissorTest(true);
    this.views = [];
    this.follow = "formation"; // or "path", or the number of a vehicle
    this.highlight = null; // the number of a follower, from 1
    this.orbit = new Orbit(canvas.parentElement, changed);
    this.paint(false);
  }

  addView(element, followers) {
    const view = new View(this, element, followers);
    this.views.push(view);
    view.paint(this.colours);
    return view;
  }

  clear() {
    this.views.forEach((view) => view.labels.forEach((label) => label.remove()));
    this.views = [];
  }

  paint(dark) {
    this.colours = palette(dark);
    this.renderer.setClearColor(this.colours.stage);
    this.views.forEach((view) => view.paint(this.colours));
  }

  render() {
    const { renderer, canvas } = this;
    const frame = canvas.getBoundingClientRect();
    if (!frame.width || !frame.height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
    const size = renderer.getSize(new THREE.Vector2());
    if (size.x !== Math.floor(frame.width) || size.y !== Math.floor(frame.height)) {
      renderer.setSize(Math.floor(frame.width), Math.floor(frame.height), false);
    }
    for (const view of this.views) {
      const place = view.element.getBoundingClientRect();
      const [x, y] = [place.left - frame.left, frame.bottom - place.bottom];
      renderer.setViewport(x, y, place.width, place.height);
      renderer.setScissor(x, y, place.width, place.height);
      view.render(place.width, place.height);
    }
  }
}

class View {
  constructor(stage, element, followers) {
    this.stage = stage;
    this.element = element;
    this.followers = followers;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera();
    this.world = new THREE.Group(); // everything in it is north-east-down
    this.world.matrixAutoUpdate = false;
    this.world.matrix.set(0, 1, 0, 0, 0, 0, -1, 0, -1, 0, 0, 0, 0, 0, 0, 1);
    this.scene.add(this.world);
    this.addLights();
    const many = (count, make) => Array.from({ length: count }, (_, i) => make(i));
    const n = followers + 1;
    this.floor = new Floor();
    this.vehicles = many(n, (i) => new Quadrotor(i === 0));
    this.shadows = many(n, () => new Shadow());
    this.stems = many(n, () => new Ribbon(2, { width: 1, strength: 0.3 }));
    this.trails = many(n, (i) => new Ribbon(TRAIL, { width: i ? 2.4 : 3, strength: 0.9 }));
    this.slots = many(followers, () => new Slot());
    this.gaps = many(followers, () => new Ribbon(2, { width: 1.6, dash: 0.07 }));
    this.path = null;
    this.world.add(this.floor.mesh);
    for (const list of [this.shadows, this.stems, this.trails, this.slots, this.gaps]) {
      list.forEach((each) => this.world.add(each.mesh));
    }
    this.vehicles.forEach((each) => this.world.add(each.group));
    this.labels = n > LABELLED ? [] : many(n, (i) => this.addLabel(i));
    this.state = null;
    this.spacing = 1;
  }

  addLights() {
    this.sky = new THREE.HemisphereLight("#ffffff", "#8f9cab", 1.9);
    this.sun = new THREE.DirectionalLight("#fff6e8", 2.2);
    this.sun.position.set(3, 6, 4);
    const back = new THREE.DirectionalLight("#bcd4ff", 0.8);
    back.position.set(-4, 3, -5);
    this.scene.add(this.sky, this.sun, back);
  }

  addLabel(i) {
    const label = document.createElement("span");
    label.className = "vehicle-label";
    label.textContent = i === 0 ? "L" : String(i);
    label.setAttribute("aria-hidden", "true");
    this.element.append(label);
    return label;
  }

  paint(colours) {
    this.floor.paint(colours);
    for (let i = 0; i <= this.followers; i++) {
      const colour = i === 0 ? colours.leader : colourOf(i - 1, colours);
      this.vehicles[i].paint(colour, colours.frame);
      this.trails[i].colour = colour;
      this.stems[i].colour = colours.path;
      this.shadows[i].material.uniforms.colour.value.set(colours.shadow);
      if (this.labels[i]) this.labels[i].style.setProperty("--own", colour);
      if (i > 0) {
        this.slots[i - 1].material.color.set(colour);
        this.gaps[i - 1].colour = colour;
      }
    }
    if (this.path) this.path.colour = colours.path;
  }

  // The leader's path, numbers north east down after each other; also what `follow = "path"` shows.
  setPath(points) {
    if (this.path) this.world.remove(this.path.mesh);
    const count = points.length / 3;
    this.extent = ball(count, (k) => points.subarray(3 * k, 3 * k + 3));
    const dash = Math.max(0.12, 0.06 * this.extent.radius);
    this.path = new Ribbon(Math.max(2, count), { width: 1.4, dash, strength: 0.75 });
    this.path.draw(count, (k) => points.subarray(3 * k, 3 * k + 3));
    this.path.colour = this.stage.colours.path;
    this.world.add(this.path.mesh);
  }

  // One moment; see the top of the file.
  show(state) {
    this.state = state;
  }

  // What the camera looks at: middle (north, east, down) and radius, m.
  focus() {
    const { positions, slots } = this.state;
    const { follow } = this.stage;
    const n = this.followers;
    const at = (k) => (k <= n ? positions.subarray(3 * k, 3 * k + 3) : slots.subarray(3 * (k - n - 1), 3 * (k - n)));
    if (follow === "path" && this.extent) return { ...this.extent, radius: 0.85 * this.extent.radius + 0.5 };
    const formation = ball(2 * n + 1, at);
    const least = 0.68;
    if (Number.isInteger(follow) && follow <= n) return { middle: [...at(follow)], radius: least };
    return { ...formation, radius: Math.max(least, 1.05 * formation.radius + 0.12) };
  }

  render(width, height) {
    if (!this.state || !width || !height) return;
    const { middle, radius } = this.focus();
    const distance = this.stage.orbit.place(this.camera, middle, radius, width, height, this.inset(height));
    this.spacing = this.floor.show(middle[0], middle[1], distance);
    this.size = Math.max(1, (SMALLEST * distance) / ARM);
    this.arrange(this.size);
    this.stage.renderer.render(this.scene, this.camera);
    this.placeLabels(width, height);
  }

  // Pixels at the top that what lies over the view takes, so that the vehicles are below it.
  inset(height) {
    const card = this.element.querySelector("[data-inset]");
    return card ? Math.min(card.offsetTop + card.offsetHeight, 0.3 * height) : 0;
  }

  arrange(size) {
    const { positions, attitudes, slots, trail, time } = this.state;
    const { highlight } = this.stage;
    for (let i = 0; i <= this.followers; i++) {
      const faded = highlight !== null && i !== 0 && i !== highlight;
      this.vehicles[i].show(positions, 3 * i, attitudes, 4 * i, time, size);
      this.shadows[i].show(positions, 3 * i, size);
      const here = positions.subarray(3 * i, 3 * i + 3);
      this.stems[i].draw(2, (k) => (k ? here : [here[0], here[1], 0]));
      this.trails[i].draw(trail.length, (k) => trail[k].subarray(3 * i, 3 * i + 3), true);
      this.trails[i].mesh.material.uniforms.strength.value = faded ? 0.15 : 0.9;
      if (i === 0) continue;
      const slot = slots.subarray(3 * i - 3, 3 * i);
      this.slots[i - 1].show(slots, 3 * i - 3, size);
      this.slots[i - 1].material.opacity = faded ? 0.2 : 0.85;
      this.gaps[i - 1].draw(2, (k) => (k ? slot : here));
    }
  }

  placeLabels(width, height) {
    const point = new THREE.Vector3();
    const { positions, failure } = this.state;
    const taken = [];
    this.labels.forEach((label, i) => {
      const above = (i === 0 ? 0.2 : 0.11) * this.size;
      point.set(positions[3 * i + 1], above - positions[3 * i + 2], -positions[3 * i]).project(this.camera);
      const [x, y] = [(0.5 + 0.5 * point.x) * width, (0.5 - 0.5 * point.y) * height];
      const outside = point.z > 1 || x < -20 || y < -20 || x > width + 20 || y > height + 20;
      // Of labels that would cover one another the first is shown.
      label.hidden = outside || taken.some((other) => Math.hypot(other[0] - x, other[1] - y) < 14);
      if (label.hidden) return;
      taken.push([x, y]);
      label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, calc(-100% - 3px))`;
      label.classList.toggle("failed", i > 0 && failure !== null && failure[i - 1] !== 0);
      label.classList.toggle("faded", this.stage.highlight !== null && i !== 0 && i !== this.stage.highlight);
    });
  }
}

// A ball around points: the middle of their box, and how far the farthest is from it.
function ball(count, point) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < count; k++) {
    point(k).forEach((x, axis) => {
      low[axis] = Math.min(low[axis], x);
      high[axis] = Math.max(high[axis], x);
    });
  }
  const middle = low.map((x, axis) => (x + high[axis]) / 2);
  let radius = 0;
  for (let k = 0; k < count; k++) {
    radius = Math.max(radius, Math.hypot(...[...point(k)].map((x, axis) => x - middle[axis])));
  }
  return { middle, radius };
}
