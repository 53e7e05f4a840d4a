// Keys and Chests: `astray.games.keys.rules` and what an agent sees of it, without Python.

import { NEVER, unreachable } from "./common.js";
import { keys, thief } from "./constants.js";
import { begin, copy, f, left, move, places as placesOf, planes as planesOf, put, touches, ways } from "./thief.js";

const { KEY, CHEST, KEY_X, KEY_Y, CHEST_X, CHEST_Y, REWARD, HIDDEN, PLANES, INVENTORIES } = keys;
const { WALL_PLANE, KEY_PLANE, CHEST_PLANE, THIEF_PLANE, HAND_PLANE, X_PLANE, Y_PLANE } = keys;

export const rules = { build, step, planes, copy, problem, places, put };

function build(level, variant) {
  return begin(level, variant, keys, {
    had: [], keys: 0, chests: 0, taken: 0, opened: 0, passed: 0, touched: 0,
    inventory: INVENTORIES.indexOf(variant.inventory), key_penalty: variant.key_penalty,
    step_penalty: variant.step_penalty, strict: variant.strict,
    first_key: NEVER, all_keys: NEVER, first_chest: NEVER, all_chests: NEVER,
    passed_chest: NEVER, keys_before_last: NEVER,
  }, addObject);
}

function addObject(s, k, x, y, off) {
  s.had[k] = 0;
  if (s.what[k] === CHEST) {
    s.chests += 1;
    return;
  }
  s.keys += 1;
  if (off) {
    const low = f(f(0.5) - f(thief.JITTER / 2));
    s.object_x[k] = f(f(x) + f(low + f(thief.JITTER * s.draws.unit())));
    s.object_y[k] = f(f(y) + f(low + f(thief.JITTER * s.draws.unit())));
  }
}

function step(s, action) {
  move(s, action);
  const [reward, terminated] = meet(s);
  return { reward: f(reward - f(s.step_penalty)), terminated };
}

function meet(s) {
  let [reward, done, touched] = [0, false, 0n];
  for (const [k] of left(s)) { // the original's order: the last made is first
    if (s.what[k] === KEY) {
      if (touches(s, k, KEY_X, KEY_Y)) reward = take(s, k, reward);
    } else if (touches(s, k, CHEST_X, CHEST_Y)) {
      if (s.taken > s.opened) {
        [reward, done] = unlock(s, k, reward);
      } else {
        const bit = 1n << BigInt(k);
        if (!(BigInt(s.touched) & bit)) s.passed += 1;
        touched |= bit;
        if (s.passed_chest === NEVER) s.passed_chest = s.time;
      }
    }
  }
  s.touched = Number(touched);
  return [reward, done];
}

function take(s, k, reward) {
  s.gone[k] = s.time;
  s.taken += 1;
  if (s.first_key === NEVER) s.first_key = s.time;
  if (s.taken === s.keys) {
    s.all_keys = s.time;
    if (s.opened < Math.min(s.keys, s.chests)) s.keys_before_last = s.time;
  }
  return f(reward - f(s.key_penalty));
}

function unlock(s, k, reward) {
  s.gone[k] = s.time;
  s.had[k] = s.taken - s.opened;
  s.opened += 1;
  if (s.first_chest === NEVER) s.first_chest = s.time;
  const done = s.opened === Math.min(s.keys, s.chests);
  if (done) s.all_chests = s.time;
  return [s.strict ? REWARD : f(reward + REWARD), done];
}

function planes(s) {
  const of = (what) => [what === KEY ? KEY_PLANE : CHEST_PLANE, 1];
  return planesOf(s, PLANES, of, [WALL_PLANE, THIEF_PLANE, X_PLANE, Y_PLANE], (mark, side) => {
    const hand = s.inventory === HIDDEN ? 0 : Math.min(s.taken - s.opened, side * side);
    for (let k = 0; k < hand; k++) mark(HAND_PLANE, k % side, Math.floor(k / side), 1);
  });
}

function problem({ grid, agent }, s) {
  const [steps, cell] = [ways(s), agent.map(Math.floor)];
  return unreachable(grid, cell, [["key", KEY], ["chest", CHEST]], (x, y) => steps[y][x] >= 0);
}

function places(s) {
  return placesOf(s, ways(s));
}
