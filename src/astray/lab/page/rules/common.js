// Shared by the rules of all games: states, cells, places, and sentences about levels.
// All constants are Python's: `astray.lab.constants` writes the module that has them. So are the
// step of each game and what an agent sees: `astray.lab.rules` writes rules/NAME-kernels.js.

import { cellsOf } from "../level.js";
import { common } from "./constants.js";
import { distances } from "./kernels.js";
import { fieldOf } from "./memory.js";

export const { NEVER, WALL } = common;
const EMPTY = "."; // in every game's drawings

// Throws where no episode can begin in a level, in the words of Python's `Level`.
function checkAgent(grid, [x, y], { LEGEND, STOOD_ON }) {
  if (!(x >= 0 && y >= 0 && y < grid.length && x < grid[0].length)) {
    throw new Error(`the agent is at cell (${x}, ${y}), outside of the level`);
  }
  const char = Object.keys(LEGEND).find((one) => LEGEND[one] === grid[y][x]);
  if (char !== EMPTY && !STOOD_ON.includes(char)) {
    throw new Error(`cell (${x}, ${y}) holds '${char}'`);
  }
}

const zeros = ([count, ...rest]) =>
  (count === undefined ? 0 : Array.from({ length: count }, () => zeros(rest)));
const here = (s) => [Math.floor(s.x), Math.floor(s.y)];

// The rules of a `game`, the object of its translated module, with the game's own
//   build(s, p, {grid, cell, looks}): fills a state of zeros without events; p: knobs as numbers;
//   contents(s): codes of the cells [y][x], as Python's `Editing.grid`;
//   open(s): the cells [y][x] that the agent can be in; or reach(s): the steps to each cell;
//   planes(s): its observation.
export function rulesOf(game, { build, contents, open, planes, reach }) {
  const steps = reach ?? ((s) => distances(open(s), ...here(s)));
  const copy = (s) => ({ ...s }); // kernels change no rows: they make others

  return {
    step: game.step, shown: game.shown, planes, open, copy,
    build({ grid, agent, looks = {} }, variant) {
      const cell = agent.map(Math.floor);
      checkAgent(grid, cell, game);
      const number = ([name, value]) => [name, game.choices[name]?.indexOf(value) ?? Number(value)];
      const p = Object.fromEntries(Object.entries(variant).map(number));
      const s = Object.fromEntries(Object.entries(game.fields).map(([name, shape]) => [name, zeros(shape)]));
      for (const event of game.events) s[event] = NEVER;
      s.time_limit = p.time_limit;
      build(s, p, { grid, cell, looks: { __proto__: null, ...looks } });
      return s;
    },
    // Sets what cells and looks do not decide of a numbered level, as the file of levels has it.
    number(s, { number, draws, fields = {} }) {
      s.level = number;
      if (draws !== undefined) game.wind(s, number, draws);
      for (const [name, bytes] of Object.entries(fields)) s[name] = fieldOf(bytes, game.fields[name]);
    },
    // The first object that the agent cannot get to, in a sentence; null where there is none.
    problem(s) {
      const [cells, away, from] = [contents(s), steps(s), here(s).join(", ")];
      for (const [name, code] of Object.entries(game.objects)) {
        const cell = cellsOf(cells, code).find(([x, y]) => away[y][x] < 0);
        if (cell) return `the ${name} at cell (${cell.join(", ")}) cannot be reached from (${from})`;
      }
      return null;
    },
    places(s) {
      const [away, at] = [steps(s), String(here(s))];
      return cellsOf(contents(s).map((row, y) => row.map((what, x) =>
        String([x, y]) === at || (what === 0 && away[y][x] >= 0))), true);
    },
    put: (s, [x, y]) => ({
      ...copy(s), x: Math.fround(x + game.within[0]), y: Math.fround(y + game.within[1]), ...game.at_rest,
    }),
    centre: (s) => [s.x + game.offset, s.y + game.offset],
  };
}

const blank = (planes, side) =>
  ({ shape: [planes, side, side], data: new Uint8Array(planes * side * side) });
const NONE = blank(0, 0);

// The part of observations that does not move, and is wider than they are, as kernels draw it.
export function drawn(kernels, s, count, side) {
  const scene = blank(count, side);
  kernels.background_planes(s, scene);
  return scene;
}

// The observation of a state, planes [C, H, W].
export function observed(kernels, s, scene, count, side) {
  const planes = blank(count, side);
  kernels.foreground_planes(s, scene ?? NONE, planes);
  return planes;
}

// The same in a maze, of which the agent sees all or a window around it.
export function observedMaze(kernels, s, count) {
  const side = s.window ? 2 * Math.floor(s.window / 2) + 1 : s.world;
  return observed(kernels, s, drawn(kernels, s, count, s.world + 2 * kernels.margin(s)), count, side);
}

// Lays a maze into a state's cells, walls around it; returns its cells [x, y] without a wall.
export function lay(s, grid, codeOf = (what) => what) {
  s.cell.forEach((row, y) => row.forEach((_, x) => { row[x] = codeOf(grid[y]?.[x] ?? WALL); }));
  const free = cellsOf(grid.map((row) => row.map((what) => what !== WALL)), true);
  const wide = (places) => Math.max(...places) - Math.min(...places) + 1;
  s.maze_size = Math.max(wide(free.map(([x]) => x)), wide(free.map(([, y]) => y)));
  return free;
}

export const world = (s, rows) => rows.slice(0, s.world).map((row) => row.slice(0, s.world));

// One step of any game, as Gymnasium's environments count it.
export function advance(rules, s, action) {
  s.time += 1;
  const [reward, terminated] = rules.step(s, action);
  const truncated = s.time >= s.time_limit && !terminated;
  s.ended = Boolean(terminated) || truncated;
  return { reward: Number(reward), terminated: Boolean(terminated), truncated };
}
