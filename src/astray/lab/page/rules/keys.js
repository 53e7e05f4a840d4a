// Keys and Chests: `astray.games.keys.rules` and what an agent sees of it, without Python.
//
// Lengths are 32-bit floats, as all of the original's; so is all arithmetic on them.

import { NEVER, WALL, checkAgent, distances, push, unreachable } from "./common.js";
import { common, keys } from "./constants.js";
import { Twister } from "./twister.js";

const f = Math.fround;
const {
  KEY, CHEST, MOST, HALF, CORNER, KEY_X, KEY_Y, CHEST_X, CHEST_Y, MIX, TOP_SPEED, DECAY, PARTS, TIES,
  REWARD, HIDDEN, STRIPS, PLANES, INVENTORIES, JITTER,
} = keys;
const { STAY } = common;

export const rules = { build, step, planes, copy, problem, places, put };

function build({ grid, agent, looks = {} }, variant) {
  const cell = agent.map(Math.floor);
  checkAgent(grid, cell, keys);
  const objects = [];
  for (let x = 0; x < grid.length; x++) {
    for (let y = 0; y < grid.length; y++) if (grid[y][x] > WALL) objects.push([x, y, grid[y][x]]);
  }
  if (objects.length > MOST) {
    throw new Error(`a level has at most ${MOST} keys and chests; this has ${objects.length}`);
  }
  const s = {
    cell: grid.map((row) => Uint8Array.from(row, (what) => (what === WALL ? 1 : 0))),
    world: grid.length, window: variant.window, x: cell[0] + 0.5, y: cell[1] + 0.5,
    vx: 0, vy: 0, facing: STAY, objects: 0, what: [], object_x: [], object_y: [], gone: [], had: [],
    keys: 0, chests: 0, taken: 0, opened: 0, passed: 0, touched: 0,
    inventory: INVENTORIES.indexOf(variant.inventory), key_penalty: variant.key_penalty,
    step_penalty: variant.step_penalty, strict: variant.strict,
    background: looks.background ?? 0, background_offset: looks.background_offset ?? 0,
    first_key: NEVER, all_keys: NEVER, first_chest: NEVER, all_chests: NEVER,
    passed_chest: NEVER, keys_before_last: NEVER,
    time: 0, time_limit: variant.time_limit, ended: false, level: 0,
  };
  const [number, draws] = looks.twister ?? [NEVER, 0];
  s.draws = new Twister(Math.max(number, 0));
  for (let k = 0; k < draws; k++) s.draws.word();
  for (const [x, y, what] of objects) addObject(s, what, x, y, number !== NEVER);
  if (looks.details) { // where keys are in their cells
    const beside = new Map(looks.details.map(([x, y, ...where]) => [`${x},${y}`, where]));
    objects.forEach(([x, y, what], k) => {
      if (what !== KEY) return;
      const [right, up] = beside.get(`${x},${y}`) ?? [0.5, 0.5];
      [s.object_x[k], s.object_y[k]] = [f(x + right), f(y + up)];
    });
  }
  return s;
}

function addObject(s, what, x, y, off) {
  const k = s.objects++;
  [s.what[k], s.gone[k], s.had[k]] = [what, NEVER, 0];
  [s.object_x[k], s.object_y[k]] = [x + 0.5, y + 0.5];
  if (what === CHEST) {
    s.chests += 1;
    return;
  }
  s.keys += 1;
  if (off) {
    const low = f(f(0.5) - f(JITTER / 2));
    s.object_x[k] = f(f(x) + f(low + f(JITTER * s.draws.unit())));
    s.object_y[k] = f(f(y) + f(low + f(JITTER * s.draws.unit())));
  }
}

function copy(s) {
  return { ...s, gone: [...s.gone], had: [...s.had], draws: s.draws.copy() };
}

function step(s, action) {
  move(s, action, s.draws.below(TIES));
  const [reward, terminated] = meet(s);
  return { reward: f(reward - f(s.step_penalty)), terminated };
}

function pushed(v, way) {
  return f(DECAY * f(f(f(1 - MIX) * v) + f(f(MIX * TOP_SPEED) * way)));
}

function move(s, action, tie) {
  const [ax, ay] = push(action);
  if (ax !== 0 || ay !== 0) s.facing = action;
  const [vx, vy] = [pushed(s.vx, ax), pushed(s.vy, ay)];
  const fast = [Math.abs(vx), Math.abs(vy)];
  let xFirst = fast[0] > fast[1] || (fast[0] === fast[1] && tie % 2 === 0);
  if (ax !== 0 || ay !== 0) xFirst = ay === 0;
  let [freeX, freeY] = [0, 0];
  for (let part = 0; part < PARTS; part++) {
    let metX, metY;
    if (xFirst) {
      metX = slideX(s, f(vx / PARTS));
      metY = slideY(s, f(vy / PARTS));
    } else {
      metY = slideY(s, f(vy / PARTS));
      metX = slideX(s, f(vx / PARTS));
    }
    freeX += metX ? 0 : 1;
    freeY += metY ? 0 : 1;
    if (metX && metY) break;
  }
  s.vx = f(vx * (freeX / PARTS));
  s.vy = f(vy * (freeY / PARTS));
}

function slideX(s, way) {
  if (way === 0) return false;
  let x = f(s.x + way);
  const front = way > 0 ? f(x + CORNER) : f(x - CORNER);
  const met = isWall(s, front, f(s.y - CORNER)) || isWall(s, front, f(s.y + CORNER));
  if (met) x = way > 0 ? f(Math.floor(f(x + HALF)) - HALF) : f(Math.ceil(f(x - HALF)) + HALF);
  s.x = x;
  return met;
}

function slideY(s, way) {
  if (way === 0) return false;
  let y = f(s.y + way);
  const front = way > 0 ? f(y + CORNER) : f(y - CORNER);
  const met = isWall(s, f(s.x - CORNER), front) || isWall(s, f(s.x + CORNER), front);
  if (met) y = way > 0 ? f(Math.floor(f(y + HALF)) - HALF) : f(Math.ceil(f(y - HALF)) + HALF);
  s.y = y;
  return met;
}

function isWall(s, x, y) {
  if (x < 0 || y < 0 || x >= s.world || y >= s.world) return true;
  return s.cell[Math.trunc(y)][Math.trunc(x)] === WALL;
}

function meet(s) {
  let [reward, done, touched] = [0, false, 0n];
  for (let k = s.objects - 1; k >= 0; k--) { // the original's order: the last made is first
    if (s.gone[k] !== NEVER) continue;
    const dx = Math.abs(f(s.object_x[k] - s.x));
    const dy = Math.abs(f(s.object_y[k] - s.y));
    if (s.what[k] === KEY) {
      if (dx < KEY_X && dy < KEY_Y) reward = take(s, k, reward);
    } else if (dx < CHEST_X && dy < CHEST_Y) {
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

// The agent's observation, planes [C, H, W]: walls, keys, chests, thief, hand, and where in its cell.
function planes(s) {
  const side = s.window ? 2 * Math.floor(s.window / 2) + 1 : s.world;
  const half = side >> 1;
  let [x, y] = [Math.trunc(s.x), Math.trunc(s.y)];
  const [left, low] = s.window ? [x - half, y - half] : [0, 0];
  const data = new Uint8Array(PLANES * side * side);
  const mark = (plane, i, j, what) => { data[(plane * side + j) * side + i] = what; };
  for (let j = 0; j < side; j++) {
    for (let i = 0; i < side; i++) mark(0, i, j, isWall(s, left + i, low + j) ? 1 : 0);
  }
  for (let k = 0; k < s.objects; k++) {
    const [i, j] = [Math.trunc(s.object_x[k]) - left, Math.trunc(s.object_y[k]) - low];
    if (s.gone[k] === NEVER && i >= 0 && j >= 0 && i < side && j < side) {
      mark(s.what[k] === KEY ? 1 : 2, i, j, 1);
    }
  }
  [x, y] = [x - left, y - low];
  mark(3, x, y, 1);
  mark(5, x, y, 1 + Math.trunc(f(f(s.x - Math.floor(s.x)) * STRIPS)));
  mark(6, x, y, 1 + Math.trunc(f(f(s.y - Math.floor(s.y)) * STRIPS)));
  if (s.inventory !== HIDDEN) {
    const hand = Math.min(s.taken - s.opened, side * side);
    for (let k = 0; k < hand; k++) mark(4, k % side, Math.floor(k / side), 1);
  }
  return { shape: [PLANES, side, side], data };
}

function ways(s) {
  const open = s.cell.map((row) => [...row].map((what) => what !== WALL));
  return distances(open, Math.trunc(s.x), Math.trunc(s.y));
}

function problem({ grid, agent }, s) {
  const steps = ways(s);
  const cell = agent.map(Math.floor);
  return unreachable(grid, cell, [["key", KEY], ["chest", CHEST]], (x, y) => steps[y][x] >= 0);
}

function places(s) {
  const [steps, found, taken] = [ways(s), [], new Set()];
  for (let k = 0; k < s.objects; k++) {
    if (s.gone[k] === NEVER) taken.add(`${Math.trunc(s.object_x[k])},${Math.trunc(s.object_y[k])}`);
  }
  for (let y = 0; y < s.world; y++) {
    for (let x = 0; x < s.world; x++) {
      const here = x === Math.trunc(s.x) && y === Math.trunc(s.y);
      if (here || (steps[y][x] >= 0 && !taken.has(`${x},${y}`))) found.push([x, y]);
    }
  }
  return found;
}

function put(s, [x, y]) {
  return { ...s, x: x + 0.5, y: y + 0.5, vx: 0, vy: 0 };
}
