// Where a shift's goals are, and which was reached first.

import { NEVER } from "../rules/common.js";
import { goals } from "../rules/constants.js";
import { distances } from "../rules/kernels.js";

const { NEITHER } = goals;

// The cells of the shift's goals, null where one has none, and of other goals; of those that share
// an event, the first.
export function namedPlaces(game, shift, s, rules, name) {
  if (!rules.target) throw new Error(`the game '${name}' has no cells, which this needs`);
  const [places, events, own] = [{}, new Set(), [shift.intended, ...shift.proxies]];
  for (const goal of [...own, ...Object.keys(game.goals)]) {
    const [event, cell] = [game.goals[goal] ?? goal, rules.target(s, goal)];
    if (events.has(event) || !(cell || own.includes(goal))) continue;
    places[goal] = cell;
    events.add(event);
  }
  return places;
}

export function firstGoal(s, shift, events) {
  const reached = [shift.intended, ...shift.proxies].filter((goal) => s[events[goal]] !== NEVER);
  return reached.reduce((best, goal) => best === NEITHER || s[events[goal]] < s[events[best]]
    ? goal : best, NEITHER);
}

// Whether no shortest way over `open` cells [y][x] to the first of `places` passes another, and none
// to these passes the first; null if a way to one does and another does not,
// or if one cannot be reached.
export function waysPart(open, start, [goal, ...others]) {
  const found = others.flatMap((other) => [passes(goal, other), passes(other, goal)]);
  return found.includes(true) ? false : found.includes(null) ? null : true;

  function passes(to, by) {
    const [direct, first, rest] = [[start, to], [start, by], [by, to]].map(([a, b]) => steps(open, a, b));
    if (direct < 0 || first < 0) return null;
    if (first + rest > direct) return false;
    const without = open.map((row, y) => row.map((free, x) => free && String([x, y]) !== String(by)));
    return first === 0 || rest === 0 || steps(without, start, to) !== direct || null;
  }
}

const steps = (open, from, [x, y]) => distances(open, ...from)[y][x];
