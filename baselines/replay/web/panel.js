// The plots of flights: of the followers of one, or of several policies beside one another.
import { colourOf, dashOf, ofPolicy } from "./colours.js";
import { TimePlot } from "./plots.js";

export class Panel {
  // `laws` are the names of the Lyapunov functions; `seek(t)` and `highlighted(follower or null)` are called.
  constructor(parent, flights, laws, { seek, highlighted }) {
    this.flights = flights;
    this.laws = laws;
    this.highlighted = highlighted;
    this.chosen = flights.length > 1 ? null : 0; // the flight whose followers are shown; null: all policies
    this.highlight = null;
    this.entry = 0;
    this.colours = null;
    this.choices = document.createElement("div");
    this.choices.className = "choices";
    this.legend = document.createElement("div");
    this.legend.className = "legend";
    parent.append(this.choices, this.legend);
    const last = Math.max(...flights.map((flight) => flight.last));
    const collision = Math.min(...flights.map((flight) => flight.collision));
    const make = (title, unit, more = {}) => {
      const plot = new TimePlot(parent, { title, unit, seek, ...more });
      plot.setSpan(0, last);
      return plot;
    };
    this.errors = make("Slot error", "m", { low: 0 });
    this.separations = make("To the nearest vehicle", "m", {
      low: 0,
      limit: { value: collision, name: `collision below ${collision.toFixed(2)} m` },
    });
    this.distances = make("To the leader", "m", { low: 0 });
    this.actions = make("Action", "of −1 … 1", { least: 0.1 });
    this.lyapunov = make("Lyapunov", "", { log: true });
    this.plots = [this.errors, this.separations, this.distances, this.actions, this.lyapunov];
    this.addLogarithm();
    this.addEntries();
    if (flights.length > 1) this.addChoices();
    this.fill();
  }

  // -- controls ----------------------------------------------------------------------------------

  addLogarithm() {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "small";
    button.textContent = "log";
    button.title = "Logarithmic scale of the slot error";
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("click", () => {
      this.errors.options.log = !this.errors.options.log;
      button.setAttribute("aria-pressed", String(this.errors.options.log));
      this.errors.draw();
    });
    this.errors.extra.append(button);
  }

  addEntries() {
    this.select = document.createElement("select");
    this.select.setAttribute("aria-label", "Entry of the action");
    this.select.addEventListener("change", () => {
      this.entry = Number(this.select.value);
      this.fill();
    });
    this.actions.extra.append(this.select);
  }

  addChoices() {
    const names = ["Compare", ...this.flights.map((flight, k) => `${letter(k)} ${flight.policy}`)];
    names.forEach((name, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "chip";
      button.title = k ? `The followers of ${name}` : "All policies in the same plots";
      button.append(name);
      button.addEventListener("click", () => this.choose(k === 0 ? null : k - 1));
      this.choices.append(button);
    });
  }

  choose(flight) {
    this.chosen = flight;
    this.highlight = null;
    this.highlighted(null);
    this.fill();
  }

  // Follower `number`, from 1, stands out, or none; a second time takes it back.
  toggle(number) {
    this.highlight = this.highlight === number ? null : number;
    this.highlighted(this.highlight);
    this.fill();
  }

  // -- contents ----------------------------------------------------------------------------------

  fill() {
    [...this.choices.children].forEach((button, k) =>
      button.setAttribute("aria-pressed", String((k === 0 ? null : k - 1) === this.chosen)),
    );
    const flight = this.flights[this.chosen ?? 0];
    this.select.replaceChildren(
      ...flight.entries.map((name, k) => new Option(name, String(k), false, k === this.entry)),
    );
    this.entry = Math.min(this.entry, flight.entries.length - 1);
    this.refresh();
    this.drawLegend();
    const number = this.highlight === null ? null : this.highlight - 1;
    this.plots.forEach((plot) => plot.setHighlight(plot === this.lyapunov && this.chosen !== null ? null : number));
  }

  // The lines anew, of flights that have gone on.
  refresh() {
    if (this.chosen === null) this.fillCompared();
    else this.fillFollowers(this.flights[this.chosen]);
  }

  fillFollowers(flight) {
    const lines = (rows) =>
      rows.map((values, i) => ({ name: `follower ${i + 1}`, mark: String(i + 1), number: i, times: flight.times, values }));
    this.errors.setTitle("Slot error", "m");
    this.errors.setSeries(lines(flight.errors()));
    this.separations.setTitle("To the nearest vehicle", "m");
    this.separations.setSeries(lines(flight.separations()));
    this.distances.element.hidden = false;
    this.distances.setSeries(lines(flight.leaderDistances()));
    this.actions.setTitle("Action", "of −1 … 1");
    this.select.hidden = false;
    this.actions.options.low = null;
    this.actions.setSeries(lines(flight.commands(this.entry)));
    this.lyapunov.element.hidden = !flight.lyapunov;
    if (!flight.lyapunov) return;
    const own = this.highlight;
    this.lyapunov.setTitle(
      "Lyapunov",
      own === null ? (flight.followers > 1 ? "mean" : "") : `follower ${own}`,
    );
    this.lyapunov.setSeries(
      this.laws.map((mark, which) => {
        const rows = flight.lyapunovs(which);
        return { name: mark, mark, number: which, times: flight.times, values: own === null ? mean(rows) : rows[own - 1] };
      }),
    );
  }

  fillCompared() {
    const lines = (of) =>
      this.flights.map((flight, number) => ({
        name: flight.policy,
        mark: letter(number),
        number: ofPolicy(number),
        times: flight.times,
        values: of(flight),
      }));
    this.errors.setTitle("Slot error", "m, RMS");
    this.errors.setSeries(lines((flight) => meanSquare(flight.errors())));
    this.separations.setTitle("Closest two vehicles", "m");
    this.separations.setSeries(lines((flight) => least(flight.separations())));
    this.distances.element.hidden = true;
    this.select.hidden = true;
    this.actions.setTitle("Effort", "RMS of the actions");
    this.actions.options.low = 0;
    this.actions.setSeries(
      lines((flight) => meanSquare(flight.entries.flatMap((_, entry) => flight.commands(entry)))),
    );
    const lawful = this.flights.map((flight) => flight.lyapunov !== null);
    this.lyapunov.element.hidden = !lawful.includes(true);
    this.lyapunov.setTitle(this.laws[3], "mean of followers");
    this.lyapunov.setSeries(
      lines((flight) => (flight.lyapunov ? mean(flight.lyapunovs(3)) : null)).filter(({ values }) => values),
    );
  }

  // The followers' names, which are pressed; of policies the names are those to choose from.
  drawLegend() {
    [...this.choices.children].slice(1).forEach((button, k) => {
      button.querySelector("svg")?.remove();
      button.prepend(sample(ofPolicy(k), this.colours));
    });
    const count = this.chosen === null ? 0 : this.flights[this.chosen].followers;
    this.legend.hidden = count < 2;
    this.legend.replaceChildren(
      ...Array.from({ length: count }, (_, i) => {
        const chip = document.createElement("button");
        chip.type = "button";
        chip.className = "chip";
        chip.title = `Make follower ${i + 1} stand out`;
        chip.setAttribute("aria-label", `follower ${i + 1}`);
        chip.setAttribute("aria-pressed", String(this.highlight === i + 1));
        chip.append(sample(i, this.colours), count > 6 ? String(i + 1) : `follower ${i + 1}`);
        chip.addEventListener("click", () => this.toggle(i + 1));
        return chip;
      }),
    );
  }

  paint(colours) {
    this.colours = colours;
    this.plots.forEach((plot) => plot.paint(colours));
    this.drawLegend();
  }

  setTime(t) {
    this.plots.forEach((plot) => plot.setTime(t));
  }
}

export function letter(number) {
  return String.fromCharCode(65 + (number % 26));
}

// A short piece of line in the colour and dashes of a number.
export function sample(number, colours) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 26 8");
  svg.setAttribute("class", "sample");
  svg.setAttribute("aria-hidden", "true");
  const line = document.createElementNS(svg.namespaceURI, "line");
  const attributes = { x1: 0, y1: 4, x2: 26, y2: 4, "stroke-width": 3, "stroke-dasharray": dashOf(number).join(" ") };
  if (colours) attributes.stroke = colourOf(number, colours);
  Object.entries(attributes).forEach(([name, value]) => line.setAttribute(name, value));
  svg.append(line);
  return svg;
}

const columnwise = (rows, of) => Float32Array.from(rows[0], (_, j) => of(rows.map((row) => row[j])));
const sum = (numbers) => numbers.reduce((a, b) => a + b, 0);
const mean = (rows) => columnwise(rows, (x) => sum(x) / x.length);
const meanSquare = (rows) => columnwise(rows, (x) => Math.sqrt(sum(x.map((v) => v * v)) / x.length));
const least = (rows) => columnwise(rows, (x) => Math.min(...x));
