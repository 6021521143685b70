// What stands in a scene: quadrotors, slots, the floor. Body axes forward, right, down; metres.
import * as THREE from "three";

export const ARM = 0.14; // from the middle to a rotor's hub, as in `formation_env.rendering.geometry`
const ROTOR = 0.084;
const HUBS = [1, -1].flatMap((x) => [1, -1].map((y) => [x * ARM * Math.SQRT1_2, y * ARM * Math.SQRT1_2]));

// A geometry of several, each moved by a matrix.
function merged(parts) {
  const arrays = { position: [], normal: [] };
  const index = [];
  for (const [geometry, matrix] of parts) {
    const first = arrays.position.length / 3;
    const own = geometry.clone().applyMatrix4(matrix);
    for (const name of Object.keys(arrays)) {
      for (const x of own.attributes[name].array) arrays[name].push(x);
    }
    for (const k of own.index.array) index.push(first + k);
  }
  const whole = new THREE.BufferGeometry();
  for (const [name, numbers] of Object.entries(arrays)) {
    whole.setAttribute(name, new THREE.BufferAttribute(new Float32Array(numbers), 3));
  }
  whole.setIndex(index);
  return whole;
}

function placed(x, y, z, { turn = [0, 0, 0], size = [1, 1, 1] } = {}) {
  const rotation = new THREE.Quaternion().setFromEuler(new THREE.Euler(...turn));
  return new THREE.Matrix4().compose(new THREE.Vector3(x, y, z), rotation, new THREE.Vector3(...size));
}

const UPRIGHT = { turn: [Math.PI / 2, 0, 0] }; // of cylinders, whose axis is y

function frameGeometry() {
  const bar = new THREE.BoxGeometry(2 * ARM, 0.014, 0.009);
  const motor = new THREE.CylinderGeometry(0.013, 0.015, 0.026, 14);
  const leg = new THREE.CylinderGeometry(0.004, 0.004, 0.06, 6);
  return merged([
    [bar, placed(0, 0, 0, { turn: [0, 0, Math.PI / 4] })],
    [bar, placed(0, 0, 0, { turn: [0, 0, -Math.PI / 4] })],
    ...HUBS.map(([x, y]) => [motor, placed(x, y, -0.008, UPRIGHT)]),
    ...HUBS.map(([x, y]) => [leg, placed(0.45 * x, 0.45 * y, 0.035, UPRIGHT)]),
  ]);
}

// What has the vehicle's colour: hull, nose, guards around the rotors.
function shellGeometry(leader) {
  const hull = new THREE.SphereGeometry(1, 28, 18);
  const nose = new THREE.ConeGeometry(0.022, 0.06, 16);
  const guard = new THREE.TorusGeometry(ROTOR, 0.0045, 8, 40);
  const beacon = new THREE.ConeGeometry(0.035, 0.07, 4);
  return merged([
    [hull, placed(0, 0, -0.006, { size: [0.066, 0.048, 0.03] })],
    [nose, placed(0.085, 0, -0.002, { turn: [0, 0, -Math.PI / 2] })],
    ...HUBS.map(([x, y]) => [guard, placed(x, y, -0.022)]),
    ...(leader ? [[beacon, placed(0, 0, -0.13, { turn: [Math.PI / 2, 0, 0] })]] : []),
  ]);
}

function bladeGeometry() {
  const blade = new THREE.BoxGeometry(1.9 * ROTOR, 0.011, 0.002);
  return merged([[blade, placed(0, 0, 0)]]);
}

let shapes = null;

function shared() {
  shapes ??= {
    frame: frameGeometry(),
    follower: shellGeometry(false),
    leader: shellGeometry(true),
    blade: bladeGeometry(),
    disc: new THREE.CircleGeometry(ROTOR, 36),
    slot: slotGeometry(),
    shadow: new THREE.PlaneGeometry(1, 1),
  };
  return shapes;
}

const SPIN = 31; // rad/s, slow enough to be seen

export class Quadrotor {
  constructor(leader) {
    const of = shared();
    this.shell = new THREE.MeshStandardMaterial({ roughness: 0.42, metalness: 0.05 });
    this.frame = new THREE.MeshStandardMaterial({ roughness: 0.6, metalness: 0.2 });
    this.haze = new THREE.MeshBasicMaterial({
      transparent: true,
      opacity: 0.2,
      side: THREE.DoubleSide,
      depthWrite: false,
    });
    this.group = new THREE.Group();
    this.group.add(new THREE.Mesh(of.frame, this.frame));
    this.group.add(new THREE.Mesh(leader ? of.leader : of.follower, this.shell));
    this.blades = HUBS.map(([x, y]) => {
      const blade = new THREE.Mesh(of.blade, this.frame);
      const disc = new THREE.Mesh(of.disc, this.haze);
      blade.position.set(x, y, -0.024);
      disc.position.set(x, y, -0.0245);
      this.group.add(blade, disc);
      return blade;
    });
  }

  paint(colour, frame) {
    this.shell.color.set(colour);
    this.haze.color.set(colour);
    this.frame.color.set(frame);
  }

  // `p` and `q` are arrays with the vehicle's numbers from `at` and `atq` on; q is (w, x, y, z).
  show(p, at, q, atq, time, size) {
    this.group.position.set(p[at], p[at + 1], p[at + 2]);
    this.group.quaternion.set(q[atq + 1], q[atq + 2], q[atq + 3], q[atq]).normalize();
    this.group.scale.setScalar(size);
    // Neighbouring rotors turn against each other.
    this.blades.forEach((blade, k) => (blade.rotation.z = (k === 0 || k === 3 ? 1 : -1) * SPIN * time + k));
  }
}

// A broken ring around where a vehicle's rotors should be, and its middle.
function slotGeometry() {
  const radius = 1.75 * ARM;
  const arcs = 16;
  const arc = new THREE.TorusGeometry(radius, 0.006, 6, 6, (0.58 * 2 * Math.PI) / arcs);
  return merged([
    ...Array.from({ length: arcs }, (_, k) => [arc, placed(0, 0, 0, { turn: [0, 0, (2 * Math.PI * k) / arcs] })]),
    [new THREE.SphereGeometry(0.014, 12, 8), placed(0, 0, 0)],
  ]);
}

export class Slot {
  constructor() {
    this.material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.8 });
    this.mesh = new THREE.Mesh(shared().slot, this.material);
  }

  show(p, at, size) {
    this.mesh.position.set(p[at], p[at + 1], p[at + 2]);
    this.mesh.scale.setScalar(size);
  }
}

// A soft spot on the floor under a vehicle.
export class Shadow {
  constructor() {
    this.material = new THREE.ShaderMaterial({
      transparent: true,
      depthWrite: false,
      side: THREE.DoubleSide,
      uniforms: { colour: { value: new THREE.Color() }, strength: { value: 0.3 } },
      vertexShader: "varying vec2 at; void main() { at = uv - 0.5; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
      fragmentShader: `uniform vec3 colour; uniform float strength; varying vec2 at;
        void main() { gl_FragColor = vec4(colour, strength * (1.0 - smoothstep(0.05, 0.5, length(at))));
          #include <colorspace_fragment>
        }`,
    });
    this.mesh = new THREE.Mesh(shared().shadow, this.material);
  }

  show(p, at, size) {
    const height = Math.max(0, -p[at + 2]);
    this.mesh.position.set(p[at], p[at + 1], -0.002);
    this.mesh.scale.setScalar((0.5 + 0.08 * height) * size);
    this.material.uniforms.strength.value = 0.3 / (1 + 0.35 * height);
  }
}

// The floor p_z = 0 with a grid of two meshes, the wider one ten times as wide; it fades into the background.
export class Floor {
  constructor() {
    this.uniforms = {
      floor: { value: new THREE.Color() },
      stage: { value: new THREE.Color() },
      grid: { value: new THREE.Color() },
      strong: { value: new THREE.Color() },
      middle: { value: new THREE.Vector2() },
      reach: { value: 10 },
      spacing: { value: 1 },
    };
    const material = new THREE.ShaderMaterial({
      side: THREE.DoubleSide,
      depthWrite: false,
      uniforms: this.uniforms,
      vertexShader: `varying vec2 at; uniform vec2 middle; uniform float reach;
        void main() {
          vec3 p = vec3(position.xy * 2.2 * reach + middle, 0.0);
          at = p.xy;
          gl_Position = projectionMatrix * modelViewMatrix * vec4(p, 1.0);
        }`,
      fragmentShader: `varying vec2 at; uniform vec2 middle; uniform float reach; uniform float spacing;
        uniform vec3 floor; uniform vec3 stage; uniform vec3 grid; uniform vec3 strong;
        float line(float width, float pixels) {
          vec2 x = at / width;
          vec2 d = fwidth(x);
          vec2 near = abs(fract(x - 0.5) - 0.5) / max(d, vec2(1e-6));
          float dense = 1.0 - smoothstep(0.15, 0.5, max(d.x, d.y));
          return dense * (1.0 - smoothstep(pixels - 0.5, pixels + 0.5, min(near.x, near.y)));
        }
        void main() {
          float fade = 1.0 - smoothstep(0.25, 1.0, length(at - middle) / reach);
          vec3 c = mix(floor, grid, 0.75 * line(spacing, 0.5));
          c = mix(c, strong, line(5.0 * spacing, 0.8));
          gl_FragColor = vec4(mix(stage, c, fade), 1.0);
          #include <colorspace_fragment>
        }`,
    });
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
  }

  paint(colours) {
    for (const name of ["floor", "stage", "grid", "strong"]) this.uniforms[name].value.set(colours[name]);
  }

  // Around a point (north, east), seen from a distance; returns the width of a mesh, m.
  show(north, east, distance) {
    const exponent = Math.log10(Math.max(distance, 1e-3) / 7);
    const power = 10 ** Math.floor(exponent);
    const share = exponent - Math.floor(exponent);
    const spacing = power * (share < 0.18 ? 1 : share < 0.52 ? 2 : share < 0.88 ? 5 : 10);
    this.uniforms.middle.value.set(north, east);
    this.uniforms.reach.value = 7 * distance;
    this.uniforms.spacing.value = spacing;
    return spacing;
  }
}
