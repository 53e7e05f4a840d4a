// Heist: its levels, without Python.

import { NEVER, observedMaze, unreachable } from "./common.js";
import { heist } from "./constants.js";
import * as kernels from "./heist-kernels.js";
import { begin, copy, left, places as placesOf, put, ways } from "./thief.js";

const { COLOURS, KEY, DOOR_CODE, GEM, PLANES, OBJECTS, LEGEND } = heist;
const planes = (s) => observedMaze(kernels, s, PLANES);

export const rules = { build, step: kernels.step, planes, copy, problem, places, put };

const isDoor = (what) => what >= DOOR_CODE && what < GEM;
const bit = (what) => 1 << ((what - KEY) % COLOURS.length);

function build(level, variant) {
  const s = begin(level, variant, heist, { keys: 0, hand: 0, reached_gem: NEVER }, (t, k) => {
    if (t.what[k] < DOOR_CODE) t.keys |= bit(t.what[k]);
  });
  for (const name of COLOURS) [s[`took_${name}`], s[`opened_${name}`]] = [NEVER, NEVER];
  for (const name of level.looks?.hand ?? []) s.hand |= 1 << COLOURS.indexOf(name);
  s.keys |= s.hand;
  s.all_keys = s.hand && s.hand === s.keys ? 0 : NEVER;
  return s;
}

// Steps from the thief with the keys on its way.
function withKeys(s) {
  const things = new Map(left(s).map(([k, x, y]) => [`${x},${y}`, s.what[k]]));
  for (let hand = s.hand; ;) {
    const steps = ways(s, (x, y) => {
      const what = things.get(`${x},${y}`);
      return isDoor(what) && !(hand & bit(what));
    });
    const before = hand;
    for (const [k, x, y] of left(s)) {
      if (s.what[k] < DOOR_CODE && steps[y][x] >= 0) hand |= bit(s.what[k]);
    }
    if (hand === before) return steps;
  }
}

function problem({ grid, agent }, s) {
  const steps = withKeys(s);
  const objects = Object.entries(OBJECTS).map(([name, char]) => [name, LEGEND[char]]);
  return unreachable(grid, agent.map(Math.floor), objects, (x, y) => steps[y][x] >= 0);
}

function places(s) {
  return placesOf(s, withKeys(s));
}
