// Colours that colour-blind people tell apart (Okabe and Ito), lighter in the dark, and what else tells lines
// and vehicles apart: dashes and numbers.

const LIGHT = {
  followers: ["#0072b2", "#d55e00", "#00855f", "#b4488a", "#a87400", "#2f8fc4"],
  leader: "#1d2630",
  stage: "#e9eef4",
  floor: "#dde5ee",
  grid: "#bccad8",
  strong: "#9fb0c2",
  path: "#6b7b8d",
  shadow: "#33445a",
  frame: "#39424d",
  ink: "#1d2630",
  faint: "#5c6b7a",
  rule: "#dfe5ec",
  bad: "#b3261e",
  sky: "#ffffff",
};

const DARK = {
  followers: ["#56b4f5", "#ff9147", "#2fcf9f", "#f09ccb", "#f0bd3a", "#a9d8f7"],
  leader: "#f4f7fa",
  stage: "#10161e",
  floor: "#161e28",
  grid: "#34424f",
  strong: "#4a5c6e",
  path: "#8193a5",
  shadow: "#000000",
  frame: "#8d9aa8",
  ink: "#eef3f8",
  faint: "#a3b2c1",
  rule: "#26313d",
  bad: "#ff8a80",
  sky: "#cfe3ff",
};

// Lengths of stroke and gap in pixels.
const DASHES = [[], [7, 3], [2, 2.5], [9, 3, 2, 3], [12, 4], [4, 2, 1, 2, 1, 2]];

export function palette(dark) {
  return dark ? DARK : LIGHT;
}

// Numbers of policies in a comparison: they take the colours that the first followers do not have.
const POLICIES = 100;
const ORDER = [3, 4, 2, 0, 1];

export function ofPolicy(number) {
  return POLICIES + number;
}

// The colour of a follower, or of a policy by its `ofPolicy`.
export function colourOf(number, colours) {
  if (number === POLICIES) return colours.leader;
  const place = number > POLICIES ? ORDER[(number - POLICIES - 1) % ORDER.length] : number;
  return colours.followers[place % colours.followers.length];
}

// Its dashes: another one for each time that the colours have been used up.
export function dashOf(of) {
  const number = of % POLICIES;
  return DASHES[(number + Math.floor(number / LIGHT.followers.length)) % DASHES.length];
}

// The name of a vehicle: 0 is the leader.
export function vehicleName(number) {
  return number === 0 ? "leader" : `follower ${number}`;
}
