// Keys and Chests: its levels, without Python.

import { NEVER, observedMaze, unreachable } from "./common.js";
import { keys, thief } from "./constants.js";
import * as kernels from "./keys-kernels.js";
import { begin, copy, f, places as placesOf, put, ways } from "./thief.js";

const { KEY, CHEST, PLANES, INVENTORIES } = keys;
const planes = (s) => observedMaze(kernels, s, PLANES);

export const rules = { build, step: kernels.step, planes, copy, problem, places, put };

function build(level, variant) {
  return begin(level, variant, keys, {
    had: [], keys: 0, chests: 0, taken: 0, opened: 0, passed: 0, touched: 0, at_inventory: 0,
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

function problem({ grid, agent }, s) {
  const [steps, cell] = [ways(s), agent.map(Math.floor)];
  return unreachable(grid, cell, [["key", KEY], ["chest", CHEST]], (x, y) => steps[y][x] >= 0);
}

function places(s) {
  return placesOf(s, ways(s));
}
