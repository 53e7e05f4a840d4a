// Maze: its levels, for a page without Python.
//
// A test compares thousands of random steps with Python's, state by state.

import { NEVER, WALL, cellsOf, checkAgent, distances, observedMaze, unreachable } from "./common.js";
import { maze } from "./constants.js";
import * as kernels from "./maze-kernels.js";

const { EMPTY, GOAL, OTHER, BOTH, SHAPES, COLOURS, OTHERS, WALLS } = maze;
const DISH = OTHERS.indexOf("dish");

export const rules = { build, step: kernels.step, planes, copy, problem, places, put };

function only(grid, codes, name) {
  const found = codes.flatMap((code) => cellsOf(grid, code));
  if (found.length > 1) {
    const cells = found.map(([x, y]) => `(${x}, ${y})`).join(", ");
    throw new Error(`a level has at most one ${name}; this has one at each of [${cells}]`);
  }
  return found[0] ?? [NEVER, NEVER];
}

function build({ grid, agent, looks = {} }, variant) {
  const world = grid.length;
  const cell = agent.map(Math.floor);
  checkAgent(grid, cell, maze);
  const [goal_x, goal_y] = only(grid, [GOAL, BOTH], "goal");
  const [other_x, other_y] = only(grid, [OTHER, BOTH], "other");
  if (cellsOf(grid, BOTH).length && variant.other_shape !== "dish") {
    throw new Error("a goal lies on the other object only where that is a dish");
  }
  let [right, top] = [-1, -1];
  grid.forEach((row, y) => row.forEach((what, x) => {
    if (what !== WALL) [right, top] = [Math.max(right, x), Math.max(top, y)];
  }));
  const open = grid[top][right] !== WALL;
  const s = {
    cell: grid.map((row) => Uint8Array.from(row)),
    world, window: variant.window, x: cell[0] + 0.5, y: cell[1] + 0.5, faces_right: false,
    goal_x, goal_y, other_x, other_y,
    corner_x: open ? right : NEVER, corner_y: open ? top : NEVER,
    goal_shape: SHAPES.indexOf(variant.goal_shape), goal_colour: COLOURS.indexOf(variant.goal_colour),
    other_shape: OTHERS.indexOf(variant.other_shape), dish_planes: variant.dish_planes,
    other_colour: COLOURS.indexOf(variant.other_colour),
    walls: WALLS.indexOf(variant.walls), background: looks.background ?? 0,
    background_offset: looks.background_offset ?? 0,
    reached_goal: NEVER, reached_corner: NEVER, reached_other: NEVER,
    time: 0, time_limit: variant.time_limit, ended: false, level: 0,
  };
  kernels.note_arrivals(s);
  return s;
}

function copy(s) {
  return { ...s, cell: s.cell.map((row) => row.slice()) };
}

// Walls, mouse, dish (in as many planes as a variant says), shapes, colours.
function planes(s) {
  return observedMaze(kernels, s, 4 + (s.other_shape === DISH ? s.dish_planes : 0));
}

function ways(s) {
  const open = s.cell.map((row) => [...row].map((what) => what !== WALL));
  return distances(open, Math.floor(s.x), Math.floor(s.y));
}

function problem({ grid, agent }, s) {
  const steps = ways(s);
  const cell = agent.map(Math.floor);
  const objects = [["goal", GOAL], ["other", OTHER], ["goal on other", BOTH]];
  return unreachable(grid, cell, objects, (x, y) => steps[y][x] >= 0);
}

function places(s) {
  const [steps, found] = [ways(s), []];
  for (let y = 0; y < s.world; y++) {
    for (let x = 0; x < s.world; x++) {
      const here = x === Math.floor(s.x) && y === Math.floor(s.y);
      if (here || (s.cell[y][x] === EMPTY && steps[y][x] >= 0)) found.push([x, y]);
    }
  }
  return found;
}

function put(s, [x, y]) {
  const other = copy(s);
  [other.x, other.y] = [x + 0.5, y + 0.5];
  return other;
}
