// The levels and observations of Heist and of Keys and Chests: `astray.kernel.thief` without Python.
//
// Lengths are 32-bit floats, as all of the original's; so is all arithmetic on them.

import { NEVER, WALL, checkAgent, distances } from "./common.js";
import { common, thief } from "./constants.js";
import { Twister } from "./twister.js";

export const f = Math.fround;
const { STRIPS } = thief;

// The state of a level; `put(s, k, x, y, off)` fills in each object k, which may be off centre.
export function begin({ grid, agent, looks = {} }, variant, game, fields, put) {
  const cell = agent.map(Math.floor);
  checkAgent(grid, cell, game);
  const objects = [];
  for (let x = 0; x < grid.length; x++) {
    for (let y = 0; y < grid.length; y++) if (grid[y][x] > WALL) objects.push([x, y]);
  }
  if (objects.length > game.MOST) {
    throw new Error(`a level has at most ${game.MOST} things; this has ${objects.length}`);
  }
  const s = {
    cell: grid.map((row) => Uint8Array.from(row, (what) => (what === WALL ? 1 : 0))),
    world: grid.length, window: variant.window, x: cell[0] + 0.5, y: cell[1] + 0.5,
    vx: 0, vy: 0, facing: common.STAY, objects: 0, what: [], object_x: [], object_y: [], gone: [],
    background: looks.background ?? 0, background_offset: looks.background_offset ?? 0,
    time: 0, time_limit: variant.time_limit, ended: false, level: 0, ...fields,
  };
  const [number, draws] = looks.twister ?? [NEVER, 0];
  s.draws = new Twister(Math.max(number, 0));
  for (let k = 0; k < draws; k++) s.draws.word();
  for (const [x, y] of objects) {
    const k = s.objects++;
    [s.what[k], s.gone[k]] = [grid[y][x], NEVER];
    [s.object_x[k], s.object_y[k]] = [x + 0.5, y + 0.5];
    put(s, k, x, y, number !== NEVER);
  }
  if (looks.details) { // where things are in their cells
    const beside = new Map(looks.details.map(([x, y, ...where]) => [`${x},${y}`, where]));
    objects.forEach(([x, y], k) => {
      const [right, up] = beside.get(`${x},${y}`) ?? [0.5, 0.5];
      [s.object_x[k], s.object_y[k]] = [f(x + right), f(y + up)];
    });
  }
  return s;
}

function isWall(s, x, y) {
  if (x < 0 || y < 0 || x >= s.world || y >= s.world) return true;
  return s.cell[Math.trunc(y)][Math.trunc(x)] === WALL;
}

// Objects that are left, the last made first: [k, x, y] with their cells.
export function left(s) {
  const cells = s.what.map((_, k) => [k, Math.trunc(s.object_x[k]), Math.trunc(s.object_y[k])]);
  return cells.filter(([k]) => s.gone[k] === NEVER).reverse();
}

// The agent's observation, planes [C, H, W]: walls in `wallPlane`; objects, where `of(what)` is
// [plane, value]; the thief's cell, and its place in it, in `thiefPlanes`; `hand` adds the rest.
export function planes(s, count, of, [wallPlane, ...thiefPlanes], hand) {
  const side = s.window ? 2 * Math.floor(s.window / 2) + 1 : s.world;
  const half = side >> 1;
  const [x, y] = [Math.trunc(s.x), Math.trunc(s.y)];
  const [west, low] = s.window ? [x - half, y - half] : [0, 0];
  const data = new Uint8Array(count * side * side);
  const mark = (plane, i, j, what) => { data[(plane * side + j) * side + i] = what; };
  for (let j = 0; j < side; j++) {
    for (let i = 0; i < side; i++) mark(wallPlane, i, j, isWall(s, west + i, low + j) ? 1 : 0);
  }
  for (const [k, u, v] of left(s)) {
    const [i, j] = [u - west, v - low];
    const [plane, value] = of(s.what[k]);
    if (i >= 0 && j >= 0 && i < side && j < side) mark(plane, i, j, value);
  }
  const inside = [s.x, s.y].map((at) => 1 + Math.trunc(f(f(at - Math.floor(at)) * STRIPS)));
  [1, ...inside].forEach((what, k) => mark(thiefPlanes[k], x - west, y - low, what));
  hand(mark, side);
  return { shape: [count, side, side], data };
}

// Steps to every cell from the thief's, over cells that are neither walls nor `isShut(x, y)`.
export function ways(s, isShut = () => false) {
  const open = s.cell.map((row, y) => [...row].map((what, x) => what !== WALL && !isShut(x, y)));
  return distances(open, Math.trunc(s.x), Math.trunc(s.y));
}

export function places(s, steps) {
  const found = [];
  const taken = new Set(left(s).map(([, x, y]) => `${x},${y}`));
  for (let y = 0; y < s.world; y++) {
    for (let x = 0; x < s.world; x++) {
      const here = x === Math.trunc(s.x) && y === Math.trunc(s.y);
      if (here || (steps[y][x] >= 0 && !taken.has(`${x},${y}`))) found.push([x, y]);
    }
  }
  return found;
}

export const copy = (s) => ({
  ...s, gone: [...s.gone], had: s.had && [...s.had], draws: s.draws.copy(),
});

export function put(s, [x, y]) {
  return { ...s, x: x + 0.5, y: y + 0.5, vx: 0, vy: 0 };
}
