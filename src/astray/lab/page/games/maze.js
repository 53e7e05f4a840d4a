// Drawing of Maze in the lab.

import { drawMaze, heading } from "./common.js";
import { maze } from "../rules/constants.js";

const { WALLS, OTHERS, COLOURS } = maze;
const FLOOR = "#ece6d6";
const UNSEEN = "rgba(60, 60, 60, 0.35)"; // the outline of an object that the agent does not see

export const look = { still, moving, direction, agent: "mouse", proxies, has, holds };

function still(brush, { grid }, s, pictures) {
  drawMaze(brush, grid, pictures.get(`wall-${WALLS[s.walls]}`), FLOOR);
}

function moving(brush, level, s, pictures) {
  for (const what of ["other", "goal"]) {
    const [x, y] = [s[`${what}_x`], s[`${what}_y`]];
    if (x < 0 || (what === "goal" && s.reached_goal >= 0)) continue;
    object(brush, OTHERS[s[`${what}_shape`]], COLOURS[s[`${what}_colour`]], x, y, pictures);
  }
  brush.stamp(pictures.get("mouse"), s.x, s.y, 0.86, 0.86, s.faces_right);
}

function object(brush, shape, colour, x, y, pictures) {
  if (shape !== "none") {
    brush.stamp(pictures.tint(shape, colour), x + 0.5, y + 0.5, 0.84);
    return;
  }
  brush.square(x + 0.2, y + 0.2, 0.6);
  brush.stroke(UNSEEN, 0.05, 0, [0.12, 0.1]);
}

// The cells that a proxy of the goals is at, to be marked.
function proxies(s) {
  return s.corner_x >= 0 ? { corner: [s.corner_x, s.corner_y] } : {};
}

// Whether levels of a variant, with these knobs, have objects of a name.
function has(name, knobs) {
  return name === "goal" || knobs?.other_shape !== "none";
}

// Whether a level has the thing that an event is about.
function holds(event, s) {
  return s[`${event.replace("reached_", "")}_x`] >= 0;
}

// Where an action leads: the rules step in x first, and then no more.
function direction(name) {
  const [x, y] = heading(name);
  return x ? [x, 0] : [0, y];
}
