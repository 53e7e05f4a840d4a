// CoinRun: its levels, without Python.

import { cellsOf } from "../level.js";
import { drawn, observed, rulesOf } from "./common.js";
import { coinrun } from "./constants.js";
import { game } from "./coinrun-kernels.js";

const f = Math.fround;
const {
  WORLD, EMPTY, COIN, NOTHING, CRATE, SAW, CRATE_HERE, SAW_HERE, WALKER_LEFT, SAW_AND_LEFT,
  HALF, TALL, WALKERS, VIEW, AROUND, PLANES, STILL_PLANES,
} = coinrun;
const FAR = 9; // cells from the runner to places with arrows; in the live lab 16, as Python is faster

export const rules = {
  ...rulesOf(game, { build, contents, reach, planes: (s) => observed(game, s, s.scene, PLANES, VIEW) }),
  problem: () => null, // Python looks for a way by the real physics, which takes too long here
};

function build(s, p, { grid, cell, looks }) {
  game.clear(s);
  s.cell = grid.map((row) => row.map((what) => (what < CRATE_HERE ? what : EMPTY)));
  s.thing = grid.map((row) => row.map((what) =>
    what === CRATE_HERE ? CRATE : what === SAW_HERE || what >= SAW_AND_LEFT ? SAW : NOTHING));
  [s.x, s.y, s.continues] = [f(cell[0] + HALF), f(cell[1] + TALL), Boolean(p.continues)];
  [s.end_x, s.end_y] = looks.end;
  [s.runner_look, s.ground, s.permeable] = [looks.runner ?? 0, looks.ground ?? 0, looks.permeable ?? 0];
  [s.background, s.background_offset] = [looks.background ?? 0, looks.background_offset ?? 0];
  const details = Object.fromEntries((looks.details ?? []).map(([x, y, look]) => [`${x},${y}`, look]));
  const walkers = [];
  for (let x = 0; x < WORLD; x++) {
    for (let y = 0; y < WORLD; y++) {
      const what = grid[y][x];
      if (what < WALKER_LEFT) continue;
      walkers.push([x, y, what === WALKER_LEFT || what === SAW_AND_LEFT, details[`${x},${y}`] ?? 0]);
    }
  }
  walkers.push(...(looks.walkers ?? []));
  if (walkers.length > WALKERS) {
    throw new Error(`a level has at most ${WALKERS} walkers; this has ${walkers.length}`);
  }
  for (const walker of walkers) game.add_walker(s, ...walker);
  for (const [x, y] of cellsOf(grid, COIN)) { // the lowest of the last column
    if (x > s.coin_x) [s.coin_x, s.coin_y] = [x, y];
  }
  s.scene = drawn(game, s, STILL_PLANES, WORLD + 2 * AROUND); // once, as it takes a millisecond
}

function contents(s) {
  return s.cell.map((row, y) => row.map((what, x) => what || s.thing[y][x]));
}

// 0 near the runner, else -1; whether it can get there is not known without Python.
function reach(s) {
  return s.cell.map((row, y) => row.map((_, x) =>
    (Math.max(Math.abs(x - Math.floor(s.x)), Math.abs(y - Math.floor(s.y))) > FAR ? -1 : 0)));
}
