// The time that is shown: it runs, stands still, is set, at a speed.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

export class Clock {
  // `changed(time)` is called whenever the time is another, `running(whether)` when it starts or stops.
  constructor(last, changed, running) {
    Object.assign(this, { last, changed, running });
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.before = 0;
  }

  set(time) {
    this.time = Math.min(this.last, Math.max(0, time));
    this.changed(this.time);
  }

  // From the beginning where the end has been reached.
  play() {
    if (this.playing) return;
    if (this.time >= this.last) this.set(0);
    this.playing = true;
    this.before = performance.now();
    this.running(true);
    requestAnimationFrame((now) => this.frame(now));
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.running(false);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  // The next faster (1) or slower (-1) speed.
  change(by) {
    const k = SPEEDS.indexOf(this.speed) + by;
    this.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, k))];
  }

  frame(now) {
    if (!this.playing) return;
    // A page that was hidden goes on where it was; slow machines take up to so long for a picture.
    const passed = Math.min(0.5, Math.max(0, (now - this.before) / 1000));
    this.before = now;
    this.set(this.time + passed * this.speed);
    if (this.time >= this.last) this.pause();
    else requestAnimationFrame((next) => this.frame(next));
  }
}
