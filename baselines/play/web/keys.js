// What a key does on the page; nothing for most.

import { sharedKeys } from "./camera.js";

const find = (id) => document.getElementById(id);

export function actionOf(play, key) {
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
    ...sharedKeys(
      play.stage?.orbit,
      (what) => play.setFollow(what),
      play.theme,
      () => play.open("help-text"),
    ),
  }[key.length === 1 ? key.toLowerCase() : key];
  if (found || !/^[1-9]$/.test(key)) return found;
  return find("vehicle").querySelector(`[value="${key}"]`) ? () => (find("vehicle").value = key) : null;
}
