// CoinRun: `astray.games.coinrun.rules` and what an agent sees of it, without Python.
//
// Numbers and the order of things are those of the Python module, function by function; it
// calculates with 32-bit floats, and so does this.

import { NEVER, checkAgent, push } from "./common.js";
import { coinrun } from "./constants.js";

const f = Math.fround;
const {
  WORLD, PUFFS, REWARD, EMPTY, WALL, TOP, LAVA, LAVA_TOP, BARRIER, COIN, INVISIBLE, PERMEABLE,
  NOTHING, CRATE, SAW, CRATE_HERE, SAW_HERE, WALKER_LEFT, SAW_AND_LEFT, HALF, TALL, CORNER, NEAR,
  FOOT, GRAVITY, JUMP, FASTEST, MIX_GROUND, MIX_AIR, STROLL, TURN, WALKERS, EVENTS, VIEW, AROUND,
  GAUGE, PLANES, STAND, WALK, WALL_PLANE, HAZARD_PLANE, CRATE_PLANE, COIN_PLANE, LEFT_PLANE,
  RIGHT_PLANE, GAUGE_PLANE, EDGE,
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

function step(s, action) {
  const outcome = act(s, action, true); // of levels as data the twister draws nothing but zeros
  for (let k = 0; k < s.walkers; k++) {
    s.trail_x[k].pop();
    s.trail_x[k].unshift(s.walker_x[k]);
  }
  return outcome;
}

function act(s, action, horizontalFirst) {
  let [ax, ay] = push(action);
  const supported = isSupported(s);
  if (ay === 1 && !supported) ay = 0;
  accelerate(s, ax, ay, supported);
  stroll(s, s.vy < 0 && ay >= 0);
  move(s, ax, ay, horizontalFirst);
  s.x = f(Math.min(Math.max(s.x, HALF), WORLD - HALF));
  s.y = f(Math.min(Math.max(s.y, TALL), WORLD - TALL));
  pose(s, ax, supported);
  return meet(s);
}

const stops = (cell) => cell === WALL || cell === TOP;
const isLava = (cell) => cell === LAVA || cell === LAVA_TOP;
const inside = (i, j) => i >= 0 && j >= 0 && i < WORLD && j < WORLD;

function isSolid(s, x, y) {
  const [i, j] = [Math.floor(x), Math.floor(y)];
  return !inside(i, j) || stops(s.cell[j][i]);
}

function turnedBy(s, x, y) {
  const [i, j] = [Math.floor(x), Math.floor(y)];
  if (!inside(i, j)) return WALL;
  const cell = s.cell[j][i];
  return stops(cell) || cell === BARRIER ? cell : EMPTY;
}

function stroll(s, cratesStop) {
  const reach = f(HALF * CORNER);
  for (let k = 0; k < s.walkers; k++) {
    const y = s.walker_y[k];
    let free = 0;
    for (let part = 0; part < 4; part++) {
      const vx = s.walker_vx[k];
      let x = f(s.walker_x[k] + f(vx * 0.25));
      const met = [
        turnedBy(s, f(x - reach), f(y - reach)), turnedBy(s, f(x - reach), f(y + reach)),
        turnedBy(s, f(x + reach), f(y - reach)), turnedBy(s, f(x + reach), f(y + reach)),
      ];
      if (met.some((what) => what !== EMPTY)) {
        const edge = vx > 0 ? f(Math.floor(f(x + HALF)) - HALF) : f(Math.ceil(f(x - HALF)) + HALF);
        x = f(f(2 * edge) - x);
        s.walker_vx[k] = -vx;
      }
      s.walker_x[k] = f(Math.min(Math.max(x, HALF), WORLD - HALF));
      if (met.includes(WALL)) {
        if (cratesStop && isInCrate(s, s.walker_x[k], y)) break;
      } else {
        free += 1;
      }
    }
    s.walker_vx[k] = f(s.walker_vx[k] * f(free * 0.25));
  }
}

function isInCrate(s, x, y) {
  const [i, j] = [Math.floor(f(x - HALF)), Math.floor(f(y - HALF))];
  const near = f(1 - NEAR);
  for (let row = Math.max(j, 0); row < Math.min(j + 2, WORLD); row++) {
    for (let column = Math.max(i, 0); column < Math.min(i + 2, WORLD); column++) {
      if (
        s.thing[row][column] === CRATE &&
        Math.abs(f(x - f(column + HALF))) < near &&
        Math.abs(f(y - f(row + HALF))) < near &&
        s.y >= f(row + 1 + TALL)
      ) return true;
    }
  }
  return false;
}

function isSupported(s) {
  const foot = f(HALF - FOOT);
  const below = f(s.y - f(TALL + FOOT));
  return s.vy === 0 && (
    s.on_crate || isSolid(s, f(s.x - foot), below) || isSolid(s, f(s.x + foot), below)
  );
}

function accelerate(s, ax, ay, supported) {
  const mix = supported ? MIX_GROUND : MIX_AIR;
  const least = f(mix * FASTEST);
  const vx = f(f(f(1 - mix) * s.vx) + f(least * ax));
  s.vx = Math.abs(vx) < least ? 0 : vx;
  if (ay === 1) {
    s.vy = JUMP;
    return;
  }
  let vy = s.vy;
  if (supported) vy = f(vy + f(GRAVITY * ay));
  vy = f(vy - GRAVITY);
  s.vy = Math.min(Math.max(vy, -JUMP), JUMP);
}

function move(s, ax, ay, horizontalFirst) {
  const [fast, falls] = [Math.abs(s.vx), Math.abs(s.vy)];
  if (fast !== falls) horizontalFirst = fast > falls;
  if (ax !== 0) horizontalFirst = true;
  if (ay !== 0) horizontalFirst = false;
  const speed = f(Math.sqrt(f(f(s.vx * s.vx) + f(s.vy * s.vy))));
  const parts = Math.max(4, Math.trunc(f(4 * speed)));
  const part = f(1 / parts);
  const cratesStop = ay >= 0;
  const lastY = s.y;
  s.on_crate = false;
  let [freeX, freeY] = [0, 0];
  for (let k = 0; k < parts; k++) {
    let [blockedX, blockedY] = [false, false];
    for (let turn = 0; turn < 2; turn++) {
      const sideways = (turn === 0) === horizontalFirst;
      const dx = sideways ? f(s.vx * part) : 0;
      const dy = sideways ? 0 : f(s.vy * part);
      const blocked = shove(s, dx, dy, cratesStop, lastY);
      if (sideways) blockedX ||= blocked;
      else blockedY ||= blocked;
    }
    freeX += blockedX ? 0 : 1;
    freeY += blockedY ? 0 : 1;
    if (blockedX && blockedY) break;
  }
  s.vx = f(s.vx * f(freeX * part));
  s.vy = f(s.vy * f(freeY * part));
}

function shove(s, dx, dy, cratesStop, lastY) {
  const blocked = slide(s, dx, dy);
  // A move by 0 counts as vertical; crates stop only vertical moves.
  if (dx === 0 && cratesStop && s.vy < 0) {
    const [i, j] = [Math.floor(f(s.x - HALF)), Math.floor(f(s.y - TALL))];
    for (let y = Math.max(j, 0); y < Math.min(j + 3, WORLD); y++) {
      for (let x = Math.max(i, 0); x < Math.min(i + 2, WORLD); x++) {
        if (s.thing[y][x] === CRATE && lands(s, x + 0.5, y + 0.5, lastY)) {
          s.on_crate = true;
          slide(s, 0, f(f(y + 0.5 + f(TALL + HALF)) - s.y));
          s.vy = 0;
          return true;
        }
      }
    }
  }
  return blocked;
}

function lands(s, x, y, lastY) {
  return (
    Math.abs(f(s.x - x)) < f(1 - NEAR) &&
    Math.abs(f(s.y - y)) < f(f(TALL + HALF) - NEAR) &&
    lastY >= f(f(y + HALF) + TALL)
  );
}

function slide(s, dx, dy) {
  let [x, y] = [f(s.x + dx), f(s.y + dy)];
  const [across, along] = [f(HALF * CORNER), f(TALL * CORNER)];
  const blocked =
    isSolid(s, f(x - across), f(y - along)) || isSolid(s, f(x - across), f(y + along)) ||
    isSolid(s, f(x + across), f(y - along)) || isSolid(s, f(x + across), f(y + along));
  if (blocked && dx !== 0) {
    x = dx > 0 ? f(Math.floor(f(x + HALF)) - HALF) : f(Math.ceil(f(x - HALF)) + HALF);
  } else if (blocked) {
    y = dy > 0 ? f(Math.floor(f(y + TALL)) - TALL) : f(Math.ceil(f(y - TALL)) + TALL);
  }
  [s.x, s.y] = [x, y];
  return blocked;
}

function pose(s, ax, supported) {
  if (ax !== 0) s.faces_left = ax < 0;
  if (Math.abs(s.vx) < TURN && ax === 0 && supported) s.pose = STAND;
  else s.pose = WALK + (Math.floor(s.time / 5) % 2 === 0 || !supported ? 0 : 1);
}

function meet(s) {
  let [saw, walker, lava] = [meetsSaw(s), meetsWalker(s), false];
  let [ended, reward] = [saw || walker, 0];
  const left = Math.floor(f(f(s.x - HALF) + NEAR));
  const right = Math.floor(f(f(s.x + HALF) - NEAR));
  const low = Math.floor(f(f(s.y - TALL) + NEAR));
  const high = Math.floor(f(f(s.y + TALL) - NEAR));
  for (let x = Math.max(left, 0); x <= Math.min(right, WORLD - 1); x++) {
    for (let y = Math.max(low, 0); y <= Math.min(high, WORLD - 1); y++) {
      const cell = s.cell[y][x];
      if (cell === COIN) {
        reward += REWARD;
        if (s.took_coin === NEVER) s.took_coin = s.time;
        ended = !s.continues;
        if (s.continues) saw = walker = lava = false;
      } else if (cell === INVISIBLE) {
        if (s.took_invisible === NEVER) s.took_invisible = s.time;
      } else if (isLava(cell)) {
        lava = ended = true;
      }
    }
  }
  if (saw || walker || lava) s.died = s.time;
  if (saw) s.met_saw = s.time;
  if (walker) s.met_walker = s.time;
  if (lava) s.met_lava = s.time;
  notePlaces(s);
  if (!ended && s.time >= s.time_limit) s.timed_out = s.time;
  return { reward, terminated: ended };
}

function meetsSaw(s) {
  const [left, low] = [Math.floor(f(s.x - HALF)), Math.floor(f(s.y - TALL))];
  for (let y = Math.max(low, 0); y < Math.min(low + 3, WORLD); y++) {
    for (let x = Math.max(left, 0); x < Math.min(left + 2, WORLD); x++) {
      if (s.thing[y][x] === SAW && overlaps(s, x + 0.5, y + 0.5)) return true;
    }
  }
  return false;
}

function meetsWalker(s) {
  for (let k = 0; k < s.walkers; k++) {
    if (overlaps(s, s.walker_x[k], s.walker_y[k])) return true;
  }
  return false;
}

function overlaps(s, x, y) {
  return Math.abs(f(s.x - x)) < 1 && Math.abs(f(s.y - y)) < f(TALL + HALF);
}

function notePlaces(s) {
  const [left, right] = [f(s.x - HALF), f(s.x + HALF)];
  const wall = s.end_x + 1;
  const beside =
    f(f(s.y + TALL) - NEAR) >= s.end_y && f(f(s.y - TALL) + NEAR) < s.end_y + 1;
  const note = (event, holds) => { if (s[event] === NEVER && holds) s[event] = s.time; };
  note("reached_end", (f(right - NEAR) >= s.end_x && beside) || left >= wall);
  note("touched_wall", right >= wall);
  note("passed_wall", s.permeable > 0 && left >= wall + s.permeable);
  note("passed_coin", s.coin_x !== NEVER && left >= s.coin_x + 1);
}

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
