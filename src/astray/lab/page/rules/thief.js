// The levels of Heist and of Keys and Chests: `astray.kernel.thief` without Python.

import { NEVER, WALL, checkAgent, distances } from "./common.js";
import { common } from "./constants.js";
import { Twister } from "./twister.js";

export const f = Math.fround;

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

// Objects that are left, the last made first: [k, x, y] with their cells.
export function left(s) {
  const cells = s.what.map((_, k) => [k, Math.trunc(s.object_x[k]), Math.trunc(s.object_y[k])]);
  return cells.filter(([k]) => s.gone[k] === NEVER).reverse();
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
