// Drawing of CoinRun in the lab: the whole level, and the part of it that the agent sees.

import { eachCell, heading } from "./common.js";
import { coinrun } from "../rules/constants.js";

const {
  GROUNDS, RUNNERS, POSES, VIEW, TALL, RUNNER_HEIGHT: HIGH, PERIOD, CRATES, EMPTY, WALL, TOP, LAVA, LAVA_TOP,
  COIN, INVISIBLE, PERMEABLE, CRATE_HERE, SAW_HERE, SAW_AND_LEFT,
} = coinrun;
const SKY = "#cfe3ea";

export const look = { still, moving, direction: heading, agent: "runner", view: VIEW, proxies, wide };

function still(brush, { grid, looks }, s, pictures) {
  const ground = GROUNDS[s.ground] ?? "dirt";
  const details = Object.fromEntries((looks?.details ?? []).map(([x, y, d]) => [`${x},${y}`, d]));
  eachCell(grid, (what, x, y) => {
    if (what === WALL) return brush.tile(pictures.get(`ground-${ground}`), x, y);
    if (what === TOP) return brush.tile(pictures.get(`ground-${ground}-top`), x, y);
    brush.fill(SKY, x, y);
    if (what === PERMEABLE) {
      brush.paint.globalAlpha = 0.55;
      brush.tile(pictures.get("ground-dirt"), x, y);
      brush.paint.globalAlpha = 1;
    }
    if (what === LAVA) brush.tile(pictures.get("lava"), x, y);
    if (what === LAVA_TOP) brush.tile(pictures.get("lava-top"), x, y);
    if (what === COIN) brush.tile(pictures.get("coin"), x, y);
    if (what === INVISIBLE) {
      brush.circle(x + 0.5, y + 0.5, 0.33);
      brush.stroke("rgba(90, 80, 20, 0.45)", 0.06, 1, [0.14, 0.1]);
    }
    if (what === CRATE_HERE) brush.tile(pictures.get(`crate-${(details[`${x},${y}`] ?? 0) % CRATES}`), x, y);
  });
}

function moving(brush, { grid }, s, pictures) {
  eachCell(grid, (what, x, y) => {
    if (what === SAW_HERE || what >= SAW_AND_LEFT) brush.tile(pictures.get(`saw-${s.time % 2}`), x, y);
  });
  const runner = `runner-${RUNNERS[s.runner_look]}-${POSES[s.pose]}`;
  brush.stamp(pictures.get(runner), s.x, s.y - TALL + HIGH / 2, 1, HIGH, s.faces_left);
  for (let k = 0; k < s.walkers; k++) {
    const image = pictures.get(`walker-${s.walker_look[k]}-${Math.floor(s.time / PERIOD) % 2}`);
    brush.stamp(image, s.walker_x[k], s.walker_y[k], 1, 1, s.walker_vx[k] > 0);
  }
}

// The end of a level, where the coin is in training.
function proxies(s) {
  return { end: [s.end_x, s.end_y] };
}

// The part of the world that is worth showing: [columns, rows] from the lower left.
function wide({ grid }, s) {
  let top = 0;
  grid.forEach((row, y) => row.forEach((what, x) => {
    if (x <= s.end_x && x > 0 && what !== EMPTY && y < grid.length - 1) top = Math.max(top, y);
  }));
  const columns = Math.min(grid[0].length, s.end_x + (s.permeable || 0) + 4);
  return [columns, Math.min(grid.length, Math.max(top + 6, 13))];
}
