// The page of a replay: flights side by side, the bar that plays them, keys.
import { ofPolicy, palette, vehicleName } from "./colours.js";
import { sharedKeys } from "./camera.js";
import { Clock, SPEEDS } from "./clock.js";
import { Flight, inflated, unpacked } from "./data.js";
import { Panel, letter, sample } from "./panel.js";
import { stageOrNotice } from "./scene.js";
import { Theme } from "./theme.js";

const find = (id) => document.getElementById(id);

async function start() {
  const content = JSON.parse(find("content").textContent);
  const bytes = await inflated(find("data").textContent.trim());
  const arrays = unpacked(bytes, content.blocks);
  const flights = content.episodes.map((card, number) => new Flight(card, number, arrays));
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await inflated(find("three").textContent.trim()));
  document.head.append(script);
  window.replay = new Replay(flights, content);
}

class Replay {
  constructor(flights, content) {
    this.flights = flights;
    this.last = Math.max(...flights.map((flight) => flight.last));
    this.asked = false;
    this.describe();
    this.clock = new Clock(this.last, (time) => this.show(time), (on) => this.showRunning(on));
    this.makeViews();
    this.panel = new Panel(find("plots"), flights, content.laws, {
      seek: (time) => this.seek(time),
      highlighted: (number) => {
        if (this.stage) this.stage.highlight = number;
        this.refresh();
      },
    });
    this.makeControls();
    this.theme = new Theme((dark) => {
      this.stage?.paint(dark);
      this.panel.paint(palette(dark));
      this.paintSamples(palette(dark));
      this.refresh();
    });
    this.theme.apply();
    new ResizeObserver(() => {
      this.arrange();
      this.refresh();
    }).observe(find("stage"));
    document.addEventListener("keydown", (event) => this.press(event));
    this.begin();
    document.documentElement.dataset.ready = "true";
  }

  // Where `#t=12.5` is in the address the page opens there, standing still.
  begin() {
    const wanted = /[#&]t=([\d.]+)/.exec(location.hash);
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.clock.set(wanted ? Number(wanted[1]) : 0);
    if (!wanted && !still) this.clock.play();
  }

  // -- words -------------------------------------------------------------------------------------

  describe() {
    const same = (name) => this.flights.every((flight) => flight[name] === this.flights[0][name]);
    const first = this.flights[0];
    const parts = [];
    if (same("scenario")) parts.push(first.scenario);
    if (same("action")) parts.push(`actions: ${first.action}`);
    if (same("followers")) parts.push(`${first.followers} follower${first.followers === 1 ? "" : "s"}`);
    if (same("seed") && first.seed !== null) parts.push(`seed ${first.seed}`);
    find("about").textContent = parts.join(" · ");
    this.common = { scenario: same("scenario"), action: same("action") };
  }

  figures(flight) {
    const { score, slot_error: error, min_separation: separation } = flight.metrics;
    const of = this.common;
    return [
      of.scenario && of.action ? null : `${flight.scenario}:${flight.action}`,
      `score ${score.toFixed(2)}`,
      `slot error ${error.toFixed(error < 0.1 ? 3 : 2)} m`,
      separation === null ? null : `nearest ${separation.toFixed(2)} m`,
    ].filter(Boolean);
  }

  // -- views -------------------------------------------------------------------------------------

  makeViews() {
    this.cells = this.flights.map((flight, number) => {
      const cell = document.createElement("section");
      cell.className = "view";
      cell.setAttribute("aria-label", `Flight of ${flight.policy}`);
      cell.innerHTML =
        '<div class="view-card" data-inset><h2></h2><p class="figures"></p><p class="end" hidden></p></div>' +
        '<p class="waiting" hidden>waiting for the trigger</p>';
      const title = cell.querySelector("h2");
      if (this.flights.length > 1) title.append(sample(ofPolicy(number), null), `${letter(number)} `);
      title.append(flight.policy);
      this.figures(flight).forEach((text, k) => {
        const words = document.createElement("span");
        words.textContent = k ? ` · ${text}` : text;
        cell.querySelector(".figures").append(words);
      });
      cell.querySelector(".end").textContent = flight.end ?? "";
      find("stage").append(cell);
      return cell;
    });
    this.stage = stageOrNotice(() => this.refresh());
    this.views = this.flights.map((flight, number) => {
      if (!this.stage) return null;
      const view = this.stage.addView(this.cells[number], flight.followers);
      view.setPath(flight.path);
      return view;
    });
    this.arrange();
  }

  // Rows and columns in which the views come nearest to a pleasant shape.
  arrange() {
    const { clientWidth: width, clientHeight: height } = find("stage");
    const count = this.flights.length;
    let best = [Infinity, 1];
    for (let columns = 1; columns <= count; columns++) {
      const rows = Math.ceil(count / columns);
      const odd = Math.abs(Math.log((width / columns / (height / rows)) / 1.45)) + 0.2 * (rows * columns - count);
      if (odd < best[0]) best = [odd, columns];
    }
    find("stage").style.gridTemplateColumns = `repeat(${best[1]}, 1fr)`;
  }

  paintSamples(colours) {
    this.cells.forEach((cell, number) => {
      const old = cell.querySelector(".sample");
      if (old) old.replaceWith(sample(ofPolicy(number), colours));
    });
  }

  // -- controls ----------------------------------------------------------------------------------

  makeControls() {
    const on = (id, name, act) => find(id).addEventListener(name, act);
    on("play", "click", () => this.clock.toggle());
    on("back", "click", () => this.seek(this.clock.time - 1));
    on("forth", "click", () => this.seek(this.clock.time + 1));
    on("scrub", "input", () => this.seek(Number(find("scrub").value)));
    on("speed", "change", () => (this.clock.speed = Number(find("speed").value)));
    on("follow", "change", () => this.setFollow(find("follow").value));
    on("theme", "click", () => this.theme.toggle());
    on("help", "click", () => this.showHelp());
    on("home", "click", () => this.stage?.orbit.reset());
    on("help-close", "click", () => find("help-text").close());
    find("speed").replaceChildren(...SPEEDS.map((x) => new Option(`${x}×`, String(x), false, x === 1)));
    const most = Math.max(...this.flights.map((flight) => flight.followers));
    const vehicles = Array.from({ length: most + 1 }, (_, i) => new Option(capitalised(vehicleName(i)), String(i)));
    find("follow").replaceChildren(
      new Option("Formation", "formation"),
      new Option("Whole path", "path"),
      ...vehicles,
    );
    find("scrub").max = String(this.last);
    find("scrub").step = String(this.flights[0].period);
    this.markEvents();
  }

  // Below the bar: where a trigger fired, where a flight failed.
  markEvents() {
    this.flights.forEach((flight) => {
      const add = (time, name, text) => {
        const mark = document.createElement("i");
        mark.className = name;
        mark.style.left = `${(100 * time) / this.last}%`;
        mark.title = `${flight.policy}: ${text}`;
        find("events").append(mark);
      };
      if (flight.trigger !== null) add(flight.trigger, "trigger", `trigger at ${flight.trigger.toFixed(2)} s`);
      if (flight.end !== null) add(flight.last, "failed", flight.end);
    });
  }

  setFollow(name) {
    if (!this.stage) return;
    this.stage.follow = /^\d+$/.test(name) ? Number(name) : name;
    find("follow").value = name;
    this.refresh();
  }

  showHelp() {
    const help = find("help-text");
    if (help.open) help.close();
    else help.showModal();
  }

  press(event) {
    const act = this.keys(event);
    const typing = event.target.matches?.("select, textarea, dialog *");
    const pressing = event.key === " " && event.target.matches?.("button, a");
    if (!act || typing || pressing || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  }

  keys({ key, shiftKey }) {
    const by = shiftKey ? 1 : 0.1;
    const found = {
      " ": () => this.clock.toggle(),
      ArrowLeft: () => this.seek(this.clock.time - by),
      ArrowRight: () => this.seek(this.clock.time + by),
      PageUp: () => this.seek(this.clock.time - 5),
      PageDown: () => this.seek(this.clock.time + 5),
      Home: () => this.seek(0),
      End: () => this.seek(this.last),
      ArrowUp: () => this.changeSpeed(1),
      ArrowDown: () => this.changeSpeed(-1),
      ...sharedKeys(
        this.stage?.orbit,
        (what) => this.setFollow(what),
        this.theme,
        () => this.showHelp(),
      ),
    }[key.length === 1 ? key.toLowerCase() : key];
    if (found || !/^[1-9]$/.test(key)) return found;
    return find("follow").querySelector(`[value="${key}"]`) ? () => this.setFollow(key) : null;
  }

  changeSpeed(by) {
    this.clock.change(by);
    find("speed").value = String(this.clock.speed);
  }

  // -- time --------------------------------------------------------------------------------------

  seek(time) {
    this.clock.pause();
    this.clock.set(time);
  }

  showRunning(on) {
    find("play").dataset.state = on ? "playing" : "paused";
    find("play").setAttribute("aria-label", on ? "Pause" : "Play");
  }

  show(time) {
    const text = `${time.toFixed(2)} s`;
    find("scrub").value = String(time);
    find("scrub").setAttribute("aria-valuetext", `${text} of ${this.last.toFixed(1)} s`);
    find("scrub").style.setProperty("--share", `${(100 * time) / this.last}%`);
    find("time").textContent = text;
    find("length").textContent = `/ ${this.last.toFixed(1)} s`;
    this.flights.forEach((flight, number) => {
      const state = flight.state(time, flight.trailing);
      const cell = this.cells[number];
      cell.querySelector(".end").hidden = !state.ended;
      cell.querySelector(".waiting").hidden = state.started || state.ended;
      cell.classList.toggle("over", time > flight.last + 1e-6);
      this.views[number]?.show(state);
    });
    this.panel?.setTime(time);
    this.refresh();
  }

  // Draw the scene again, once, before the next picture.
  refresh() {
    if (this.asked || !this.stage) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.stage.render();
      find("needle").style.transform = `rotate(${-this.stage.orbit.azimuth}rad)`;
      find("spacing").textContent = `${Number(this.views[0].spacing.toPrecision(2))} m`;
    });
  }
}

function capitalised(text) {
  return text[0].toUpperCase() + text.slice(1);
}

start().catch((problem) => {
  const message = find("problem");
  message.hidden = false;
  message.append(` (${problem.message})`);
  throw problem;
});
