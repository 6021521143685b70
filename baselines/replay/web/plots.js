// Plots of numbers against time, linked to it: a cursor, and a click or drag that seeks.
//
//   const plot = new TimePlot(parent, { title, unit, log, low, least, limit, seek });
//   plot.setSeries([{ name, mark, number, times, values }]);   // number: of its colour and dashes
//   plot.paint(colours); plot.setSpan(0, last); plot.setTime(t);
//
// `low` is where the axis begins, `least` how much it covers at least. `limit` is { value, name }: a level
// that is drawn. `seek(t)` is called with a time in seconds; null: a click does nothing.
import { colourOf, dashOf } from "./colours.js";

const MARGIN = { left: 44, right: 22, top: 8, bottom: 20 };
const FONT = "11px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";

export class TimePlot {
  constructor(parent, options) {
    this.options = { log: false, low: null, least: 1e-3, limit: null, seek: null, ...options };
    this.series = [];
    this.highlight = null;
    this.span = [0, 1];
    this.time = 0;
    this.colours = null;
    this.scale = null;
    this.element = document.createElement("figure");
    this.element.className = "plot";
    this.element.innerHTML =
      '<figcaption><span class="plot-title"></span><span class="plot-unit"></span><span class="plot-extra"></span>' +
      '<output class="plot-values"></output></figcaption><div class="plot-area"><canvas></canvas><canvas></canvas></div>';
    parent.append(this.element);
    const find = (name) => this.element.querySelector(name);
    this.setTitle(options.title, options.unit);
    this.extra = find(".plot-extra");
    this.readout = find(".plot-values");
    this.area = find(".plot-area");
    this.area.setAttribute("role", "img");
    [this.lines, this.cursor] = this.area.querySelectorAll("canvas");
    const seek = (event) => {
      if (!this.options.seek) return;
      const box = this.area.getBoundingClientRect();
      const share = (event.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
      const [from, to] = this.span;
      this.options.seek(from + Math.min(1, Math.max(0, share)) * (to - from));
    };
    this.area.addEventListener("pointerdown", (event) => {
      this.area.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.area.addEventListener("pointermove", (event) => event.buttons && seek(event));
    new ResizeObserver(() => this.draw()).observe(this.area);
  }

  setTitle(title, unit) {
    this.element.querySelector(".plot-title").textContent = title;
    this.element.querySelector(".plot-unit").textContent = unit;
    this.options.title = title;
  }

  setSeries(series) {
    this.series = series;
    this.draw();
  }

  setSpan(from, to) {
    this.span = [from, to];
    this.draw();
  }

  paint(colours) {
    this.colours = colours;
    this.draw();
  }

  // The series of this number stands out; null for all alike.
  setHighlight(number) {
    this.highlight = number;
    this.draw();
  }

  setTime(t) {
    this.time = t;
    this.drawCursor();
  }

  // -- scales ------------------------------------------------------------------------------------

  bounds() {
    let [low, high] = [Infinity, -Infinity];
    for (const { values } of this.series) {
      for (const v of values) {
        if (!Number.isFinite(v) || (this.options.log && v <= 0)) continue;
        low = Math.min(low, v);
        high = Math.max(high, v);
      }
    }
    if (!(low <= high)) [low, high] = [this.options.log ? 0.1 : 0, 1];
    if (this.options.log) {
      // Eight decades at most: what is below is as good as zero.
      const top = Math.ceil(Math.log10(high) + 1e-6);
      return [10 ** Math.max(Math.floor(Math.log10(low)), top - 8), 10 ** top];
    }
    const { limit, least } = this.options;
    if (limit) high = Math.max(high, limit.value * 1.15);
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const room = 0.06 * (high - low);
    return [this.options.low ?? low - room, high + room];
  }

  // -- drawing -----------------------------------------------------------------------------------

  context(canvas) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.area.clientWidth, this.area.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    g.font = FONT;
    return { g, width, height };
  }

  scales(width, height) {
    const [low, high] = this.bounds();
    const map = this.options.log ? Math.log10 : (v) => v;
    const [a, b] = [map(low), map(high)];
    const [from, to] = this.span;
    const right = width - MARGIN.right;
    const bottom = height - MARGIN.bottom;
    return {
      low,
      high,
      right,
      bottom,
      x: (t) => MARGIN.left + ((t - from) / (to - from)) * (right - MARGIN.left),
      y: (v) => bottom - ((map(Math.max(v, this.options.log ? low : -Infinity)) - a) / (b - a)) * (bottom - MARGIN.top),
    };
  }

  draw() {
    if (!this.colours || !this.area.clientWidth) return;
    const { g, width, height } = this.context(this.lines);
    const s = this.scales(width, height);
    this.scale = s;
    this.drawAxes(g, s);
    g.save();
    g.beginPath();
    g.rect(MARGIN.left, MARGIN.top - 2, s.right - MARGIN.left + 2, s.bottom - MARGIN.top + 4);
    g.clip();
    if (this.options.limit) this.drawLimit(g, s);
    const order = [...this.series].sort((a, b) => (a.number === this.highlight) - (b.number === this.highlight));
    order.forEach((each) => this.drawLine(g, s, each));
    g.restore();
    this.drawMarks(g, s);
    this.describe();
    this.drawCursor();
  }

  drawAxes(g, s) {
    const { rule, faint } = this.colours;
    g.lineWidth = 1;
    g.textBaseline = "middle";
    g.textAlign = "right";
    for (const v of this.options.log ? decades(s.low, s.high) : ticks(s.low, s.high, Math.max(2, (s.bottom - MARGIN.top) / 26))) {
      const y = Math.round(s.y(v)) + 0.5;
      if (y < MARGIN.top - 1) continue;
      stroke(g, rule, [[MARGIN.left, y], [s.right, y]]);
      g.fillStyle = faint;
      g.fillText(shortened(v), MARGIN.left - 6, y);
    }
    g.textAlign = "center";
    g.textBaseline = "top";
    for (const t of ticks(...this.span, Math.max(2, Math.floor((s.right - MARGIN.left) / 80)))) {
      const x = Math.round(s.x(t)) + 0.5;
      stroke(g, rule, [[x, MARGIN.top], [x, s.bottom]]);
      g.fillStyle = faint;
      g.fillText(`${shortened(t)} s`, x, s.bottom + 5);
    }
  }

  drawLimit(g, s) {
    const { value, name } = this.options.limit;
    const y = s.y(value);
    g.setLineDash([3, 3]);
    stroke(g, this.colours.bad, [[MARGIN.left, y], [s.right, y]]);
    g.setLineDash([]);
    g.fillStyle = this.colours.bad;
    g.textAlign = "left";
    g.textBaseline = "top";
    g.fillText(name, MARGIN.left + 4, y + 3);
  }

  drawLine(g, s, { times, values, number }) {
    const faded = this.highlight !== null && number !== this.highlight;
    g.globalAlpha = faded ? 0.22 : 1;
    g.lineWidth = number === this.highlight ? 2.6 : 1.7;
    g.lineJoin = "round";
    g.setLineDash(dashOf(number));
    g.strokeStyle = colourOf(number, this.colours);
    g.beginPath();
    let down = false;
    for (let j = 0; j < times.length; j++) {
      if (!Number.isFinite(values[j])) {
        down = false;
        continue;
      }
      const [x, y] = [s.x(times[j]), s.y(values[j])];
      if (down) g.lineTo(x, y);
      else g.moveTo(x, y);
      down = true;
    }
    g.stroke();
    g.setLineDash([]);
    g.globalAlpha = 1;
  }

  // The marks of few lines, at their ends, moved apart where they would overlap.
  drawMarks(g, s) {
    if (this.series.length > 8) return;
    const ends = this.series
      .map(({ mark, number, times, values }) => {
        let j = values.length - 1;
        while (j > 0 && !Number.isFinite(values[j])) j--;
        return { mark, number, x: s.x(times[j]) + 5, y: s.y(values[j]) };
      })
      .sort((a, b) => a.y - b.y);
    ends.forEach((end, k) => {
      if (k > 0) end.y = Math.max(end.y, ends[k - 1].y + 11);
    });
    const over = Math.max(0, (ends.length ? ends[ends.length - 1].y : 0) - s.bottom - 2);
    ends.forEach((end) => (end.y = Math.max(end.y - over, MARGIN.top + 3)));
    g.font = `600 ${FONT}`;
    g.textAlign = "left";
    g.textBaseline = "middle";
    for (const { mark, number, x, y } of ends) {
      g.fillStyle = colourOf(number, this.colours);
      g.fillText(mark, x, y);
    }
    g.font = FONT;
  }

  drawCursor() {
    if (!this.scale || !this.area.clientWidth) return;
    const { g } = this.context(this.cursor);
    const s = this.scale;
    const x = s.x(Math.min(this.span[1], Math.max(this.span[0], this.time)));
    g.lineWidth = 1.5;
    stroke(g, this.colours.ink, [[x, MARGIN.top - 4], [x, s.bottom]]);
    const values = this.series.map((each) => valueAt(each, this.time));
    this.series.forEach((each, k) => {
      if (!Number.isFinite(values[k]) || (this.highlight !== null && each.number !== this.highlight)) return;
      g.beginPath();
      g.arc(x, s.y(values[k]), 3, 0, 7);
      g.fillStyle = colourOf(each.number, this.colours);
      g.fill();
    });
    this.showValues(values);
  }

  // The values at the cursor: of a few lines each, else of the one that stands out, else the range.
  showValues(values) {
    const known = this.series.map((each, k) => ({ ...each, value: values[k] })).filter((x) => Number.isFinite(x.value));
    const chosen = known.filter((x) => this.highlight === null || x.number === this.highlight);
    const shown = chosen.length <= 4 ? chosen : [];
    const parts = shown.map(({ mark, number, value }) => ({
      mark,
      text: shortened(value, shown.length > 3 ? 2 : 3),
      colour: colourOf(number, this.colours),
    }));
    if (!shown.length && chosen.length) {
      const all = chosen.map((x) => x.value);
      parts.push({ mark: "", text: `${shortened(Math.min(...all))} … ${shortened(Math.max(...all))}`, colour: "inherit" });
    }
    const text = JSON.stringify(parts);
    if (text === this.shown) return;
    this.shown = text;
    this.readout.replaceChildren(...parts.map(valueElement));
  }

  describe() {
    const names = this.series.map(({ name }) => name).join(", ");
    const more = this.options.seek ? " Click to go to a time." : "";
    this.area.setAttribute("aria-label", `${this.options.title} against time: ${names}.${more}`);
  }
}

// -- helpers ---------------------------------------------------------------------------------------

function stroke(g, colour, points) {
  g.strokeStyle = colour;
  g.beginPath();
  points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
  g.stroke();
}

// Round numbers between two, about `count` of them.
export function ticks(low, high, count) {
  const wanted = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const step = power * ([1, 2, 5, 10].find((k) => k * power >= wanted) ?? 10);
  const found = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) found.push(v);
  return found;
}

function decades(low, high) {
  const [a, b] = [Math.round(Math.log10(low)), Math.round(Math.log10(high))];
  const stride = Math.max(1, Math.ceil((b - a) / 3));
  const found = [];
  for (let k = b; k >= a; k -= stride) found.push(10 ** k);
  return found;
}

// A number as short as it can be read.
export function shortened(v, digits = 3) {
  if (v === 0 || Math.abs(v) < 1e-12) return "0";
  const size = Math.abs(v);
  if (size < 0.001 || size >= 1e5) return v.toExponential(0).replace("e+", "e").replaceAll("-", "−");
  return String(Number(v.toPrecision(digits))).replace("-", "−");
}

// A mark and a value in a colour.
function valueElement({ mark, text, colour }) {
  const element = document.createElement("span");
  element.style.color = colour;
  const bold = document.createElement("b");
  bold.textContent = mark;
  element.append(bold, ` ${text} `);
  return element;
}

// The value at the last instant that is not later than t; NaN after the end.
export function valueAt({ times, values }, t) {
  if (t > times[times.length - 1] + 1e-6) return NaN;
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t + 1e-9) low = middle;
    else high = middle - 1;
  }
  return values[low];
}
