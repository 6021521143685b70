// The live page: flights side by side as they are flown, what is done to them, keys.
import { ofPolicy, palette, vehicleName } from "./colours.js";
import { actionOf } from "./keys.js";
import { Link } from "./link.js";
import { LiveFlight } from "./live.js";
import { Panel, letter, sample } from "./panel.js";
import { Pushing } from "./pushing.js";
import { stageOrNotice } from "./scene.js";
import { Settings, make } from "./settings.js";
import { Theme } from "./theme.js";

const find = (id) => document.getElementById(id);
const SPAN = 20; // s that the plots show
const PLOTS = 120; // ms between two pictures of them, at least

class Play {
  constructor() {
    this.flights = [];
    this.views = [];
    this.cells = [];
    this.state = null;
    this.panel = null;
    this.asked = false; // whether it is to be drawn before the next picture
    this.due = false; // whether the server waits for that
    this.fresh = true; // whether nothing is known of the server's flights
    this.drawn = { at: 0, took: 0 };
    this.makeStage();
    this.pushing = new Pushing((command) => this.send(command), () => this.stage?.orbit.azimuth ?? 0);
    this.makeControls();
    this.theme = new Theme((dark) => this.paint(dark));
    this.theme.apply();
    new ResizeObserver(() => {
      this.arrange();
      this.refresh();
    }).observe(find("stage"));
    document.addEventListener("keydown", (event) => this.press(event));
    this.link = new Link((message) => this[`take_${message.type}`](message), (on) => this.showLink(on));
  }

  // -- messages ----------------------------------------------------------------------------------

  take_hello({ controls, groups, scenarios, policies, speeds }) {
    this.settings = new Settings(find("controls"), controls, groups, {
      set: (name, value) => this.change(name, { do: "set", name, value }),
      unset: (name) => this.change(name, { do: "unset", name }),
    });
    find("scenario").replaceChildren(...scenarios.map((name) => new Option(name, name)));
    const options = () => policies.map(({ name, text }) => Object.assign(new Option(name, name), { title: text }));
    find("policy").replaceChildren(...options());
    find("beside").replaceChildren(new Option("none", ""), ...options());
    this.speeds = speeds;
    find("speed").replaceChildren(...speeds.map((x) => new Option(`${x}×`, String(x))));
  }

  take_state(state) {
    const before = this.state;
    this.state = state;
    if (this.fresh || before.epoch !== state.epoch) this.begin(state);
    this.fresh = false;
    this.settings.show(state);
    const names = state.cards.map((card) => card.policy);
    find("scenario").value = state.scenario;
    find("policy").value = names[0];
    find("beside").value = names[1] ?? "";
    for (const id of ["policy", "beside"]) {
      [...find(id).options].forEach((option) => {
        option.disabled = option.value !== "" && !state.available.includes(option.value);
      });
    }
    find("python-text").textContent = state.python;
    if (document.activeElement !== find("seed")) find("seed").value = String(state.seed);
    find("speed").value = String(state.speed);
    find("again").checked = state.again;
    find("play").dataset.state = state.paused ? "paused" : "playing";
    find("play").setAttribute("aria-label", state.paused ? "Go on" : "Pause");
    const count = Object.keys(state.changes).length;
    find("changed").textContent = count ? `${count} changed` : "as the scenario";
    find("clear").disabled = !count;
    this.showNotes(state.notes);
    const [card] = state.cards;
    const followers = `${card.followers} follower${card.followers === 1 ? "" : "s"}`;
    find("about").textContent = `${card.scenario} · actions: ${card.action} · ${followers} · seed ${state.seed}`;
    document.documentElement.dataset.ready = "true";
  }

  take_frames({ frames }) {
    frames.forEach((frame) => this.append(frame));
    this.due = true;
    this.refresh();
  }

  append({ epoch, flights }) {
    if (epoch !== this.state?.epoch) return;
    flights.forEach((frame, k) => this.flights[k].append(frame));
  }

  showNotes(notes) {
    find("notes").hidden = !notes.length;
    find("notes").querySelector("summary").textContent = notes.length === 1 ? "A warning" : `${notes.length} warnings`;
    find("notes-text").replaceChildren(...notes.map((text) => make("p", "", text)));
  }

  // -- commands ----------------------------------------------------------------------------------

  async send(command) {
    const wait = setTimeout(() => this.say("working: what a policy needs is being compiled …", true), 700);
    const answer = await this.link.send(command);
    clearTimeout(wait);
    this.say(answer.error ?? "", false, Boolean(answer.error));
    return answer;
  }

  change(name, command) {
    this.link.sendLatest(name, command, (answer) => {
      if (!answer.error) this.forgive();
      this.settings.answer(name, answer);
      if (answer.began) this.say("This takes effect from the start of an episode: it has begun anew.");
    });
  }

  async choose() {
    const names = [find("policy").value, find("beside").value].filter(Boolean);
    const { error } = await this.send({ do: "policies", value: names });
    if (error) this.restore();
  }

  restore() {
    this.take_state(this.state);
  }

  // A line at the bottom of the scene, which goes away by itself unless it is to stay.
  say(text, stay = false, wrong = false) {
    clearTimeout(this.fading);
    find("notice").textContent = text;
    find("notice").hidden = !text;
    find("notice").classList.toggle("wrong", wrong);
    if (text && !stay) this.fading = setTimeout(() => (find("notice").hidden = true), wrong ? 12000 : 5000);
  }

  showLink(on) {
    find("lost").hidden = on;
    document.documentElement.dataset.linked = String(on);
    if (on) this.fresh = true; // the server may be another one
  }

  // -- flights -----------------------------------------------------------------------------------

  begin({ cards, path }) {
    const shape = JSON.stringify(cards.map(({ policy, followers, entries, laws }) => [policy, followers, entries, laws]));
    this.flights = cards.map((card) => new LiveFlight(card, path));
    if (shape !== this.shape) this.makeViews();
    this.shape = shape;
    this.views.forEach((view, k) => view?.setPath(this.flights[k].path));
    this.drawn.at = 0;
  }

  makeStage() {
    this.stage = stageOrNotice(() => this.refresh());
  }

  makeViews() {
    const { flights } = this;
    this.cells.forEach((cell) => cell.remove());
    this.stage?.clear();
    this.cells = flights.map((flight, number) => {
      const cell = make("section", "view");
      cell.setAttribute("aria-label", `Flight of ${flight.policy}`);
      cell.innerHTML =
        '<div class="view-card" data-inset><h2></h2><p class="figures"></p><p class="end" hidden></p></div>' +
        '<p class="waiting" hidden>waiting for the trigger</p>';
      const title = cell.querySelector("h2");
      if (flights.length > 1) title.append(sample(ofPolicy(number), null), `${letter(number)} `);
      title.append(flight.policy);
      find("stage").append(cell);
      return cell;
    });
    this.views = flights.map((flight, k) => this.stage?.addView(this.cells[k], flight.followers) ?? null);
    if (this.stage) this.stage.highlight = null;
    this.arrange();
    this.panel = null; // made with the first frame
    find("plots").replaceChildren();
    const most = flights[0].followers;
    const vehicles = Array.from({ length: most + 1 }, (_, i) => new Option(vehicleName(i), String(i)));
    const followed = find("follow").value || "formation";
    find("follow").replaceChildren(new Option("formation", "formation"), new Option("whole path", "path"), ...vehicles);
    this.setFollow([...find("follow").options].some(({ value }) => value === followed) ? followed : "formation");
    this.pushing.setFollowers(most);
  }

  makePanel() {
    const laws = this.flights.find((flight) => flight.laws)?.laws ?? [];
    this.panel = new Panel(find("plots"), this.flights, laws, {
      seek: null,
      highlighted: (number) => {
        if (this.stage) this.stage.highlight = number;
        this.refresh();
      },
    });
    this.paint(this.theme.dark);
  }

  // Rows or columns, whichever leaves the views nearer to a square.
  arrange() {
    const { clientWidth: width, clientHeight: height } = find("stage");
    const columns = this.flights.length > 1 && width > 0.9 * height ? 2 : 1;
    find("stage").style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
  }

  paint(dark) {
    const colours = palette(dark);
    this.stage?.paint(dark);
    this.panel?.paint(colours);
    this.cells.forEach((cell, number) => cell.querySelector(".sample")?.replaceWith(sample(ofPolicy(number), colours)));
    this.refresh();
  }

  // -- drawing -----------------------------------------------------------------------------------

  // Draw anew, once, before the next picture.
  refresh() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      this.draw(now);
      if (this.due) this.link.drawn();
      this.due = false;
    });
  }

  draw(now) {
    if (!this.flights.length || !this.flights[0].instants) return;
    this.flights.forEach((flight, k) => {
      const state = flight.now();
      this.views[k]?.show(state);
      const cell = this.cells[k];
      const error = flight.error();
      const figures = `${flight.last.toFixed(1)} s · slot error ${error.toFixed(error < 0.1 ? 3 : 2)} m`;
      cell.querySelector(".figures").textContent = figures;
      cell.querySelector(".end").textContent = flight.end ?? "";
      cell.querySelector(".end").hidden = flight.end === null;
      cell.querySelector(".waiting").hidden = state.started || state.ended;
    });
    find("time").textContent = `${this.flights[0].last.toFixed(1)} s`;
    if (this.stage) {
      this.stage.render();
      find("needle").style.transform = `rotate(${-this.stage.orbit.azimuth}rad)`;
      find("spacing").textContent = `${Number(this.views[0].spacing.toPrecision(2))} m`;
    }
    // Of large formations the plots take long: they are drawn the less often.
    if (now - this.drawn.at > Math.max(PLOTS, 6 * this.drawn.took)) this.drawPlots(now);
  }

  drawPlots(now) {
    const begun = performance.now();
    if (!this.panel) this.makePanel();
    if (this.panel.flights !== this.flights) {
      this.panel.flights = this.flights;
      this.panel.fill();
    }
    const last = Math.max(...this.flights.map((flight) => flight.last));
    const from = Math.max(0, last - SPAN);
    for (const flight of this.flights) flight.trailing = flight.trailSeconds();
    for (const plot of this.panel.plots) {
      plot.span = [from, from + SPAN];
      plot.time = last;
    }
    this.panel.refresh();
    this.drawn = { at: now, took: performance.now() - begun };
  }

  // -- controls ----------------------------------------------------------------------------------

  makeControls() {
    const on = (id, name, act) => find(id).addEventListener(name, act);
    const value = (id) => find(id).value;
    on("play", "click", () => this.pause());
    on("restart", "click", () => this.reset(Number(value("seed"))));
    on("next", "click", () => this.reset(Number(value("seed")) + 1));
    on("seed", "change", () => this.reset(Number(value("seed"))));
    on("speed", "change", () => this.send({ do: "speed", value: Number(value("speed")) }));
    on("again", "change", () => this.send({ do: "again", value: find("again").checked }));
    on("follow", "change", () => this.setFollow(value("follow")));
    on("theme", "click", () => this.theme.toggle());
    on("home", "click", () => this.stage?.orbit.reset());
    on("help", "click", () => this.open("help-text"));
    on("show-python", "click", () => this.open("python"));
    on("copy", "click", () => this.copy());
    on("policy", "change", () => this.choose());
    on("beside", "change", () => this.choose());
    on("scenario", "change", () => this.start({ do: "scenario", value: value("scenario") }));
    on("clear", "click", () => this.start({ do: "clear" }));
    on("search", "input", () => this.settings?.filter(value("search")));
    for (const button of document.querySelectorAll("dialog .close")) {
      button.addEventListener("click", () => button.closest("dialog").close());
    }
    for (const tab of find("tabs").children) tab.addEventListener("click", () => this.setTab(tab.dataset.tab));
    this.setTab("settings");
  }

  async start(command) {
    const { error } = await this.send(command);
    if (error) this.restore();
    else this.forgive();
  }

  // What was refused before is shown as it is.
  forgive() {
    this.settings.forgive();
    this.settings.show(this.state);
  }

  pause() {
    if (this.state) this.send({ do: "pause", value: !this.state.paused });
  }

  reset(seed) {
    this.send({ do: "reset", seed });
  }

  changeSpeed(by) {
    const k = this.speeds.indexOf(this.state.speed) + by;
    if (this.speeds[k]) this.send({ do: "speed", value: this.speeds[k] });
  }

  setFollow(name) {
    find("follow").value = name;
    if (!this.stage) return;
    this.stage.follow = /^\d+$/.test(name) ? Number(name) : name;
    this.refresh();
  }

  // On a narrow screen: which of settings and plots is below the scene.
  setTab(name) {
    document.body.dataset.tab = name;
    for (const tab of find("tabs").children) tab.setAttribute("aria-pressed", String(tab.dataset.tab === name));
  }

  open(id) {
    if (find(id).open) find(id).close();
    else find(id).showModal();
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(find("python-text").textContent);
      find("copy").textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(find("python-text"));
      find("copy").textContent = "Marked: copy it";
    }
    setTimeout(() => (find("copy").textContent = "Copy"), 2000);
  }

  press(event) {
    const act = actionOf(this, event.key);
    const typing = event.target.matches?.("select, textarea, input, dialog *");
    const pressing = event.key === " " && event.target.matches?.("button, a, summary");
    if (!act || typing || pressing || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  }
}

window.play = new Play();
