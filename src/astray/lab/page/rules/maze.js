// Maze: its levels, for a page without Python.
//
// A test compares thousands of random steps with Python's, state by state.

import { cellsOf } from "../level.js";
import { NEVER, WALL, lay, observedMaze, rulesOf, world } from "./common.js";
import { maze } from "./constants.js";
import { game } from "./maze-kernels.js";

const { GOAL, OTHER, BOTH, OTHERS, GOALS } = maze;
const DISH = OTHERS.indexOf("dish");
const contents = (s) => world(s, s.cell);
const open = (s) => contents(s).map((row) => row.map((what) => what !== WALL));
// Walls, mouse, dish (in as many planes as a variant says), shapes, colours.
const planes = (s) => observedMaze(game, s, 4 + (s.other_shape === DISH ? s.dish_planes : 0));

// Its goals are cells, and the mouse reaches one by walking there.
export const rules = { ...rulesOf(game, { build, contents, open, planes }), target, walks: true };

function target(s, goal) {
  const cell = ["x", "y"].map((axis) => s[`${GOALS[goal].replace("reached_", "")}_${axis}`]);
  return cell[0] === NEVER ? null : cell;
}

function only(grid, codes, name) {
  const found = codes.flatMap((code) => cellsOf(grid, code));
  if (found.length > 1) {
    const cells = found.map(([x, y]) => `(${x}, ${y})`).join(", ");
    throw new Error(`a level has at most one ${name}; this has one at each of [${cells}]`);
  }
  return found[0] ?? [NEVER, NEVER];
}

function build(s, p, { grid, cell, looks }) {
  game.furnish(s, p);
  const free = lay(s, grid);
  [s.x, s.y] = [cell[0] + 0.5, cell[1] + 0.5];
  [s.goal_x, s.goal_y] = only(grid, [GOAL, BOTH], "goal");
  [s.other_x, s.other_y] = only(grid, [OTHER, BOTH], "other");
  if (s.other_x !== NEVER && s.other_shape === 0) {
    throw new Error("the other object would be invisible: the variant's other_shape is 'none'");
  }
  if (cellsOf(grid, BOTH).length && s.other_shape !== DISH) {
    throw new Error("a goal lies on the other object only where that is a dish");
  }
  s.dish_planes = p.dish_planes;
  const corner = [0, 1].map((axis) => Math.max(...free.map((one) => one[axis])));
  [s.corner_x, s.corner_y] = grid[corner[1]][corner[0]] === WALL ? [NEVER, NEVER] : corner;
  s.background = looks.background ?? Math.max(p.background, 0);
  s.background_offset = looks.background_offset ?? 0;
  game.note_arrivals(s);
}
