// CoinRun: its levels and what an agent sees of it, without Python.

import { NEVER, checkAgent } from "./common.js";
import { coinrun } from "./constants.js";
import { is_lava as isLava, is_supported as isSupported, step, stops } from "./coinrun-step.js";

const f = Math.fround;
const {
  WORLD, PUFFS, EMPTY, COIN, PERMEABLE, NOTHING, CRATE, SAW, CRATE_HERE, SAW_HERE, WALKER_LEFT,
  SAW_AND_LEFT, HALF, TALL, STROLL, WALKERS, EVENTS, VIEW, AROUND, GAUGE, PLANES, STAND, EDGE,
  WALL_PLANE, HAZARD_PLANE, CRATE_PLANE, COIN_PLANE, LEFT_PLANE, RIGHT_PLANE, GAUGE_PLANE,
} = coinrun;
const FAR = 9; // cells from the runner to places with arrows; in the live lab 16, as Python is faster

export const rules = { build, step, planes, copy, problem: () => null, places, put };

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

const inside = (i, j) => i >= 0 && j >= 0 && i < WORLD && j < WORLD;

// The agent's observation, planes [C, H, W]: walls, hazards, crates, coins, walkers to the left and
// to the right, and gauges of how the runner moves.
function planes(s) {
  const data = new Uint8Array(PLANES * VIEW * VIEW);
  const [x, y] = [Math.trunc(s.x), Math.trunc(s.y)];
  const mark = (plane, row, column) => { data[(plane * VIEW + row) * VIEW + column] = 1; };
  for (let row = 0; row < VIEW; row++) {
    for (let column = 0; column < VIEW; column++) {
      const [i, j] = [x + column - AROUND, y + row - AROUND];
      if (!inside(i, j)) {
        mark(WALL_PLANE, row, column);
        continue;
      }
      const [cell, thing] = [s.cell[j][i], s.thing[j][i]];
      if (stops(cell) || cell === PERMEABLE) mark(WALL_PLANE, row, column);
      if (isLava(cell) || thing === SAW) mark(HAZARD_PLANE, row, column);
      if (thing === CRATE) mark(CRATE_PLANE, row, column);
      if (cell === COIN) mark(COIN_PLANE, row, column);
    }
  }
  for (let k = 0; k < s.walkers; k++) {
    const row = Math.trunc(s.walker_y[k]) - y + AROUND;
    for (let side = 0; side < 2; side++) {
      const column = Math.floor(s.walker_x[k] - EDGE + 2 * EDGE * side) - x + AROUND;
      if (row >= 0 && column >= 0 && row < VIEW && column < VIEW) {
        mark(s.walker_vx[k] < 0 ? LEFT_PLANE : RIGHT_PLANE, row, column);
      }
    }
  }
  const gauge = (row, rate) => {
    const marks = Math.min(Math.max(Math.trunc(rate * GAUGE + 0.5), 0), GAUGE);
    for (let k = 0; k < marks; k++) mark(GAUGE_PLANE, row + Math.floor(k / VIEW), k % VIEW);
  };
  gauge(0, s.x - x);
  gauge(2, s.y - y);
  gauge(4, s.vx + 0.5);
  gauge(6, (s.vy + 1.5) / 3);
  if (isSupported(s)) for (let column = 0; column < VIEW; column++) mark(GAUGE_PLANE, 8, column);
  return { shape: [PLANES, VIEW, VIEW], data };
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
