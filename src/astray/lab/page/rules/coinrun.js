// CoinRun: its levels, without Python.

import { NEVER, checkAgent, drawn, observed } from "./common.js";
import { coinrun } from "./constants.js";
import * as kernels from "./coinrun-kernels.js";

const f = Math.fround;
const {
  WORLD, PUFFS, EMPTY, COIN, NOTHING, CRATE, SAW, CRATE_HERE, SAW_HERE, WALKER_LEFT, SAW_AND_LEFT,
  HALF, TALL, STROLL, WALKERS, EVENTS, VIEW, AROUND, PLANES, STILL_PLANES, STAND,
} = coinrun;
const FAR = 9; // cells from the runner to places with arrows; in the live lab 16, as Python is faster

const planes = (s) => observed(kernels, s, s.scene, PLANES, VIEW);

export const rules = {
  build, step: kernels.step, planes, copy, problem: () => null, places, put,
};

function build({ grid, agent, looks = {} }, variant) {
  const cell = agent.map(Math.floor);
  checkAgent(grid, cell, coinrun);
  const s = {
    cell: grid.map((row) => Uint8Array.from(row, (what) => (what < CRATE_HERE ? what : EMPTY))),
    thing: grid.map((row) => Uint8Array.from(row, (what) =>
      what === CRATE_HERE ? CRATE : what === SAW_HERE || what >= SAW_AND_LEFT ? SAW : NOTHING)),
    x: f(cell[0] + HALF), y: f(cell[1] + TALL), vx: 0, vy: 0, on_crate: false, faces_left: false,
    pose: STAND, walkers: 0, walker_x: [], walker_y: [], walker_vx: [], walker_look: [], trail_x: [],
    end_x: looks.end[0], end_y: looks.end[1], coin_x: NEVER, coin_y: NEVER,
    permeable: looks.permeable ?? 0, continues: variant.continues,
    runner_look: looks.runner ?? 0, ground: looks.ground ?? 0, background: looks.background ?? 0,
    background_offset: looks.background_offset ?? 0,
    time: 0, time_limit: variant.time_limit, ended: false, level: 0,
    draws: { below: () => 0 }, // of levels as data the twister draws nothing but zeros
  };
  for (const event of EVENTS) s[event] = NEVER;
  const details = Object.fromEntries((looks.details ?? []).map(([x, y, look]) => [`${x},${y}`, look]));
  for (let x = 0; x < WORLD; x++) {
    for (let y = 0; y < WORLD; y++) {
      const what = grid[y][x];
      if (what >= WALKER_LEFT) {
        addWalker(s, x, y, what === WALKER_LEFT || what === SAW_AND_LEFT, details[`${x},${y}`] ?? 0);
      }
      if (what === COIN && x > s.coin_x) [s.coin_x, s.coin_y] = [x, y]; // the lowest of the last
    }
  }
  for (const walker of looks.walkers ?? []) addWalker(s, ...walker);
  if (s.walkers > WALKERS) {
    throw new Error(`a level has at most ${WALKERS} walkers; this has ${s.walkers}`);
  }
  s.scene = drawn(kernels, s, STILL_PLANES, WORLD + 2 * AROUND); // once, as it takes a millisecond
  return s;
}

function addWalker(s, x, y, left, look) {
  const k = s.walkers++;
  [s.walker_x[k], s.walker_y[k]] = [f(x + HALF), f(y + HALF)];
  s.walker_vx[k] = left ? -STROLL : STROLL;
  s.walker_look[k] = look;
  s.trail_x[k] = new Array(PUFFS).fill(s.walker_x[k]);
}

function copy(s) {
  return {
    ...s, walker_x: [...s.walker_x], walker_vx: [...s.walker_vx],
    trail_x: s.trail_x.map((trail) => [...trail]),
  };
}

// Empty cells near the runner; whether it can get there is not known without Python.
function places(s) {
  const found = [];
  const [x, y] = [Math.trunc(s.x), Math.trunc(s.y)];
  for (let j = Math.max(y - FAR, 0); j <= Math.min(y + FAR, WORLD - 1); j++) {
    for (let i = Math.max(x - FAR, 0); i <= Math.min(x + FAR, WORLD - 1); i++) {
      if ((s.cell[j][i] === EMPTY && s.thing[j][i] === NOTHING) || (i === x && j === y)) {
        found.push([i, j]);
      }
    }
  }
  return found;
}

function put(s, [x, y]) {
  return { ...s, x: f(x + HALF), y: f(y + TALL), vx: 0, vy: 0, on_crate: false };
}
