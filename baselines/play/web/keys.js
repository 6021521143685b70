// What a key does on the page; nothing for most.

const find = (id) => document.getElementById(id);

export function actionOf(play, key) {
  const orbit = play.stage?.orbit;
  const found = {
    " ": () => play.pause(),
    ArrowLeft: () => play.pushing.push("left"),
    ArrowRight: () => play.pushing.push("right"),
    ArrowUp: () => play.pushing.push("away"),
    ArrowDown: () => play.pushing.push("near"),
    PageUp: () => play.pushing.push("up"),
    PageDown: () => play.pushing.push("down"),
    Delete: () => play.pushing.lose(),
    n: () => play.reset(play.state.seed + 1),
    b: () => play.reset(play.state.seed),
    ".": () => play.changeSpeed(1),
    ",": () => play.changeSpeed(-1),
    "+": () => orbit?.magnify(1.2),
    "=": () => orbit?.magnify(1.2),
    "-": () => orbit?.magnify(1 / 1.2),
    a: () => orbit?.turn(-0.12, 0),
    d: () => orbit?.turn(0.12, 0),
    w: () => orbit?.turn(0, 0.08),
    s: () => orbit?.turn(0, -0.08),
    r: () => orbit?.reset(),
    f: () => play.setFollow("formation"),
    p: () => play.setFollow("path"),
    l: () => play.setFollow("0"),
    t: () => play.theme.toggle(),
    h: () => play.open("help-text"),
    "?": () => play.open("help-text"),
  }[key.length === 1 ? key.toLowerCase() : key];
  if (found || !/^[1-9]$/.test(key)) return found;
  return find("vehicle").querySelector(`[value="${key}"]`) ? () => (find("vehicle").value = key) : null;
}
