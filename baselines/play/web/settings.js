// The controls, made from what the server says of the configuration's fields.
//
//   const settings = new Settings(parent, hello.controls, hello.groups, { set, unset });
//   settings.show(state);              // values, and which differ from the scenario
//   settings.answer(name, answer);     // what came of a change: { ok } or { error }

const OPEN = ["", "noise", "planner"]; // groups that are open at first
const OWN = "the scenario's own";

export class Settings {
  constructor(parent, controls, groups, { set, unset }) {
    Object.assign(this, { set, unset });
    this.rows = new Map();
    this.groups = new Map();
    parent.replaceChildren();
    for (const control of controls) {
      if (!this.groups.has(control.group)) this.addGroup(parent, control.group, groups[control.group]);
      const row = makeRow(control, {
        set: (value) => set(control.name, value),
        unset: () => unset(control.name),
      });
      this.rows.set(control.name, row);
      this.groups.get(control.group).append(row.element);
    }
  }

  addGroup(parent, name, text) {
    const group = make("details", "group");
    group.open = OPEN.includes(name);
    const title = make("summary");
    title.append(make("b", "", name || "formation and task"), make("span", "count"));
    group.append(title);
    if (text) group.append(make("p", "text", text));
    parent.append(group);
    this.groups.set(name, group);
  }

  show({ values, base, changes }) {
    this.rows.forEach((row, name) => row.show(values[name], base[name], changes, name in changes));
    this.groups.forEach((group) => {
      const count = group.querySelectorAll(".changed").length;
      group.querySelector(".count").textContent = count ? `${count} changed` : "";
    });
  }

  answer(name, { error }) {
    this.rows.get(name)?.complain(error ?? "");
  }

  // No complaint is of use any more.
  forgive() {
    this.rows.forEach((row) => row.complain(""));
  }

  // Show the controls whose name or meaning has all words of a text.
  filter(text) {
    const words = text.toLowerCase().split(/\s+/).filter(Boolean);
    this.rows.forEach(({ element }) => {
      const own = element.textContent.toLowerCase().replaceAll("_", " ") + element.dataset.name;
      element.hidden = !words.every((word) => own.includes(word));
    });
    this.groups.forEach((group, name) => {
      const any = [...group.querySelectorAll(".control")].some((element) => !element.hidden);
      group.hidden = !any;
      group.open = words.length ? any : OPEN.includes(name);
    });
  }
}

// -- rows ------------------------------------------------------------------------------------------

function makeRow(control, { set, unset }) {
  const element = make("div", "control");
  element.dataset.name = control.name;
  const id = `control-${control.name.replace(".", "-")}`;
  const label = make("label", "", control.name.split(".").pop().replaceAll("_", " "));
  label.htmlFor = id;
  const head = make("div", "head");
  const undo = make("button", "undo", "↺");
  undo.type = "button";
  undo.title = `Back to ${OWN}`;
  undo.setAttribute("aria-label", `${control.name}: back to ${OWN}`);
  undo.addEventListener("click", unset);
  head.append(label, make("span", "unit", control.unit), undo);
  const editor = editorOf(control, id, set, unset);
  const problem = make("p", "error");
  problem.setAttribute("role", "alert");
  problem.hidden = true;
  element.append(head, editor.element);
  if (control.text && control.kind !== "maker") element.append(make("p", "text", control.text));
  element.append(problem);
  return {
    element,
    show(value, base, changes, changed) {
      element.classList.toggle("changed", changed);
      undo.hidden = !changed;
      undo.title = base === undefined ? `Back to ${OWN}` : `Back to ${OWN}, ${JSON.stringify(base)}`;
      if (problem.hidden && !element.contains(document.activeElement)) editor.show(value, changes);
      else if (problem.hidden) editor.follow?.(value);
    },
    complain(text) {
      const over = !text && !problem.hidden;
      problem.textContent = text && `${text}. The flight goes on as it was.`;
      problem.hidden = !text;
      element.classList.toggle("wrong", Boolean(text));
      if (over) document.activeElement?.blur?.();
    },
  };
}

function editorOf(control, id, set, unset) {
  const editors = { number: range, integer: range, boolean: check, choice: select, maker, vector, json, text: json };
  const editor = editors[control.kind](control, id, set, unset);
  return control.optional && control.kind !== "json" ? optional(control, editor, set) : editor;
}

// A slider with a box for any number.
function range(control, id, set) {
  const element = make("div", "range");
  const slider = make("input");
  const box = make("input");
  Object.assign(slider, { type: "range", min: control.low, max: control.high, step: control.step, id });
  Object.assign(box, { type: "number", step: control.kind === "integer" ? 1 : "any" });
  box.setAttribute("aria-label", `${control.name}, any number`);
  slider.setAttribute("aria-describedby", `${id}-unit`);
  const show = (value) => {
    if (value === null || value === undefined) return;
    slider.max = Math.max(control.high, value);
    slider.min = Math.min(control.low, value);
    slider.value = value;
    box.value = Number(Number(value).toPrecision(6));
    slider.setAttribute("aria-valuetext", `${box.value} ${control.unit}`);
  };
  slider.addEventListener("input", () => {
    box.value = Number(Number(slider.value).toPrecision(6));
    slider.setAttribute("aria-valuetext", `${box.value} ${control.unit}`);
    set(Number(slider.value));
  });
  box.addEventListener("change", () => {
    if (box.value === "") return;
    show(Number(box.value));
    set(Number(box.value));
  });
  element.append(slider, box);
  return { element, show, value: () => Number(slider.value) };
}

function check(control, id, set) {
  const element = make("input");
  Object.assign(element, { type: "checkbox", id });
  element.addEventListener("change", () => set(element.checked));
  return { element, show: (value) => (element.checked = Boolean(value)), follow: (value) => (element.checked = value) };
}

function select(control, id, set) {
  const element = make("select");
  element.id = id;
  element.append(...control.choices.map((name) => new Option(name, name)));
  element.addEventListener("change", () => set(element.value));
  const show = (value) => (element.value = value);
  return { element, show, follow: show, value: () => element.value };
}

// Numbers side by side.
function vector(control, id, set) {
  const element = make("div", "vector");
  const count = control.default?.length ?? 3;
  const boxes = Array.from({ length: count }, (_, k) => {
    const box = make("input");
    Object.assign(box, { type: "number", step: "any", id: k ? "" : id });
    box.setAttribute("aria-label", `${control.name}, number ${k + 1} of ${count}`);
    box.addEventListener("change", () => {
      if (boxes.every((each) => each.value !== "")) set(value());
    });
    return box;
  });
  const value = () => boxes.map((box) => Number(box.value));
  element.append(...boxes);
  return { element, value, show: (numbers) => boxes.forEach((box, k) => (box.value = numbers?.[k] ?? "")) };
}

// Anything else as it stands in JSON.
function json(control, id, set) {
  const element = make("textarea");
  Object.assign(element, { id, rows: 2, spellcheck: false });
  element.addEventListener("change", () => {
    let value = element.value;
    try {
      value = JSON.parse(value);
    } catch {
      // a name: the configuration says what it expects
    }
    set(value);
  });
  return { element, show: (value) => (element.value = JSON.stringify(value)) };
}

// With a box that leaves the value to follow from others.
function optional(control, editor, set) {
  const element = make("div", "optional");
  const box = make("input");
  box.type = "checkbox";
  const label = make("label", "auto");
  label.append(box, "as it follows");
  const apply = () => (editor.element.hidden = box.checked);
  box.addEventListener("change", () => {
    apply();
    if (box.checked) set(null);
  });
  element.append(label, editor.element);
  const show = (value, changes) => {
    box.checked = value === null || value === undefined;
    apply();
    editor.show(value, changes);
  };
  return { element, show };
}

// A function by its name, and its arguments: a path, a formation.
function maker(control, id, set, unset) {
  const element = make("div", "maker");
  const names = make("select");
  names.id = id;
  names.append(new Option(OWN, ""), ...control.makers.map(({ name }) => new Option(name.replaceAll("_", " "), name)));
  const text = make("p", "text");
  const inner = make("div", "arguments");
  element.append(names, text, inner);
  let given = {};
  let shown = null;
  const send = () => (names.value ? set({ maker: names.value, ...given }) : unset());
  const arrange = () => {
    if (shown === names.value) return;
    shown = names.value;
    const chosen = control.makers.find(({ name }) => name === names.value);
    text.textContent = chosen?.text ?? control.text;
    inner.replaceChildren(
      ...(chosen?.arguments ?? []).map((argument) => {
        const row = make("div", "argument");
        const own = `${id}-${argument.name}`;
        const label = make("label", "", argument.name.replaceAll("_", " "));
        label.htmlFor = own;
        const editor = editorOf(argument, own, (value) => {
          given[argument.name] = value;
          send();
        });
        const value = given[argument.name] ?? argument.default;
        if (argument.required) given[argument.name] = value;
        editor.show(value, {});
        row.append(label, editor.element);
        return row;
      }),
    );
  };
  names.addEventListener("change", () => {
    given = {};
    arrange();
    send();
  });
  const show = (_, changes) => {
    const { maker: name = "", ...others } = changes[control.name] ?? {};
    if (names.value !== name || JSON.stringify(given) !== JSON.stringify(others)) shown = null;
    names.value = name;
    given = { ...others };
    arrange();
  };
  return { element, show };
}

export function make(name, kind = "", text = "") {
  const element = document.createElement(name);
  if (kind) element.className = kind;
  if (text) element.textContent = text;
  return element;
}
