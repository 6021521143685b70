// Lines of a width in pixels, dashed or fading, that keep their width at any distance.
import * as THREE from "three";

const VERTEX = `
attribute vec3 before;
attribute vec3 after;
attribute vec3 mark;  // side, opacity, metres along the line
uniform vec2 resolution;
uniform float width;
varying float opacity;
varying float along;
void main() {
  mat4 all = projectionMatrix * modelViewMatrix;
  vec4 here = all * vec4(position, 1.0);
  vec4 a = all * vec4(before, 1.0);
  vec4 b = all * vec4(after, 1.0);
  vec2 way = b.xy / max(b.w, 1e-3) - a.xy / max(a.w, 1e-3);
  way *= resolution;
  way = length(way) > 1e-6 ? normalize(way) : vec2(1.0, 0.0);
  here.xy += vec2(-way.y, way.x) * mark.x * width / resolution * here.w;
  opacity = mark.y;
  along = mark.z;
  gl_Position = here;
}`;

const FRAGMENT = `
uniform vec3 colour;
uniform float dash;
uniform float strength;
varying float opacity;
varying float along;
void main() {
  if (dash > 0.0 && fract(along / dash) > 0.55) discard;
  gl_FragColor = vec4(colour, opacity * strength);
  #include <colorspace_fragment>
}`;

export class Ribbon {
  // `capacity` points; `dash` is the length of a stroke and its gap in metres, 0 for none.
  constructor(capacity, { width = 2, dash = 0, strength = 1 } = {}) {
    this.capacity = capacity;
    const geometry = new THREE.BufferGeometry();
    const add = (name) => {
      const attribute = new THREE.BufferAttribute(new Float32Array(6 * capacity), 3);
      geometry.setAttribute(name, attribute);
      return attribute;
    };
    [this.position, this.before, this.after, this.mark] = ["position", "before", "after", "mark"].map(add);
    const index = [];
    for (let k = 0; k + 1 < capacity; k++) index.push(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 2, 2 * k + 1, 2 * k + 3);
    geometry.setIndex(index);
    const material = new THREE.ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      transparent: true,
      depthWrite: false,
      side: THREE.DoubleSide,
      uniforms: {
        resolution: { value: new THREE.Vector2(1, 1) },
        width: { value: width },
        dash: { value: dash },
        strength: { value: strength },
        colour: { value: new THREE.Color() },
      },
    });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    const viewport = new THREE.Vector4();
    this.mesh.onBeforeRender = (renderer) => {
      renderer.getCurrentViewport(viewport);
      material.uniforms.resolution.value.set(viewport.z, viewport.w);
      material.uniforms.width.value = width * renderer.getPixelRatio();
    };
  }

  set colour(value) {
    this.mesh.material.uniforms.colour.value.set(value);
  }

  // `point(k)` gives [x, y, z] of point k of `count`; with `fade` the first ones are transparent.
  draw(count, point, fade = false) {
    count = Math.min(count, this.capacity);
    let along = 0;
    let last = null;
    for (let k = 0; k < count; k++) {
      const here = point(k);
      const before = point(Math.max(0, k - 1));
      const after = point(Math.min(count - 1, k + 1));
      if (last) along += Math.hypot(here[0] - last[0], here[1] - last[1], here[2] - last[2]);
      last = here;
      const opacity = fade ? (k / Math.max(1, count - 1)) ** 1.4 : 1;
      for (let side = 0; side < 2; side++) {
        const v = 2 * k + side;
        this.position.setXYZ(v, here[0], here[1], here[2]);
        this.before.setXYZ(v, before[0], before[1], before[2]);
        this.after.setXYZ(v, after[0], after[1], after[2]);
        this.mark.setXYZ(v, side ? 1 : -1, opacity, along);
      }
    }
    for (const attribute of [this.position, this.before, this.after, this.mark]) attribute.needsUpdate = true;
    this.mesh.geometry.setDrawRange(0, 6 * Math.max(0, count - 1));
  }
}
