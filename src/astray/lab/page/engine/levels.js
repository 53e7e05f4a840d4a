// Levels as `astray.level` has them: drawn as text, and one for every place of a thing.

import { carried, cellsOf } from "../level.js";
import { coinrun } from "../rules/constants.js";

const { WORLD, EMPTY, WALL, TOP, PERMEABLE, SAW_HERE, WALKER_LEFT, SAW_AND_LEFT } = coinrun;
const ON = "@ on "; // begins a line below a drawing, which says what the agent stands on

// The rows of a drawing, the uppermost first, as `Level.from_text` finds them.
export function rowsOf(drawing) {
  const lines = drawing.replace(/^\ufeff/, "").split("\n").map((line) => (/[^ \t]/.test(line) ? line : ""));
  const [margin = "", ...others] = lines.filter(Boolean).map((line) => line.match(/^[ \t]*/)[0]);
  let common = margin.length;
  while (!others.every((one) => one.startsWith(margin.slice(0, common)))) common -= 1;
  const dedented = lines.map((line) => line.slice(common)).join("\n").replace(/^\n+/, "").trimEnd();
  return dedented ? dedented.split(/\r\n|[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]/) : [];
}

// Rows as cells, from the lowest up, in the words of `Level.from_text`.
export function read(lines, legend) {
  const rows = lines.toReversed();
  const beneath = rows[0]?.startsWith(ON) ? rows.shift().slice(ON.length) : ".";
  const lengths = rows.map((row) => [...row].length);
  if (new Set(lengths).size !== 1) {
    throw new Error(`a level's rows are equally long; these have [${lengths.join(", ")}]`);
  }
  if (!(beneath in legend)) {
    throw new Error(`the agent is on '${beneath}'; there are: ${Object.keys(legend).join(" ")}`);
  }
  const agents = [];
  const grid = rows.map((row, y) => [...row].map((char, x) => {
    if (char === "@") agents.push([x, y]);
    const code = legend[char === "@" ? beneath : char];
    if (code === undefined) {
      const there = [...Object.keys(legend), "@"].join(" ");
      throw new Error(`unknown '${char}' at cell (${x}, ${y}); there are: ${there}`);
    }
    return code;
  }));
  if (agents.length !== 1) throw new Error(`a level has one '@', the agent; this has ${agents.length}`);
  return { grid, agent: agents[0] };
}

// The rows of a level's drawing, the uppermost first.
export function drawn({ grid, agent }, legend) {
  const chars = Object.fromEntries(Object.entries(legend).map(([char, code]) => [code, char]));
  const rows = grid.map((row) => row.map((code) => chars[code] ?? "\ufffd")); // which `read` refuses
  const [x, y] = agent.map(Math.floor);
  const beneath = rows[y]?.[x];
  if (!beneath) throw new Error(`the agent is at cell (${x}, ${y}), outside of the level`);
  rows[y][x] = "@";
  const drawing = rows.map((row) => row.join("")).reverse();
  return beneath === "." ? drawing : [...drawing, `${ON}${beneath}`];
}

// A smaller level of CoinRun in the lower left of the whole world, walls around it.
export function whole(level) {
  const [side, wide, high] = [WORLD, level.grid[0].length, level.grid.length];
  if (Math.max(wide, high) > side) {
    throw new Error(`the level is ${wide} x ${high} cells; it is at most ${side} a side`);
  }
  const grid = Array.from({ length: side }, (_, y) => Array.from({ length: side }, (_, x) =>
    level.grid[y]?.[x] ?? WALL));
  const looks = { ...level.looks };
  looks.end ??= endOf(grid);
  looks.permeable ??= grid[looks.end[1]].filter((what) => what === PERMEABLE).length;
  return uncovered({ ...level, grid, looks });
}

// A level with the walkers that looks alone put into a cell which is empty now, as Python has it.
function uncovered(level) {
  const { walkers, ...looks } = { ...level.looks };
  const grid = level.grid.map((row) => [...row]);
  const sharing = (walkers ?? []).filter(([x, y, left, look]) => {
    if (![EMPTY, SAW_HERE].includes(grid[y]?.[x])) return true;
    grid[y][x] = (grid[y][x] === EMPTY ? WALKER_LEFT : SAW_AND_LEFT) + (left ? 0 : 1);
    const others = carried({ details: looks.details ?? [] }, [x, y]).details;
    looks.details = carried({ details: look ? [...others, [x, y, look]] : others }, null).details;
    return false;
  });
  return { ...level, grid, looks: sharing.length ? { ...looks, walkers: sharing } : looks };
}

// The lowest cell to stand in, in the last column that has one, or before a permeable wall.
function endOf(grid) {
  const ground = (what) => what === WALL || what === TOP;
  const walls = cellsOf(grid, PERMEABLE).map(([x]) => x);
  for (let x = Math.min(grid.length, ...walls) - 1; x >= 0; x--) {
    for (let y = 1; y < grid.length; y++) {
      if (!ground(grid[y][x]) && ground(grid[y - 1][x])) return [x, y];
    }
  }
  return [0, 0];
}

// A level for every place of a thing, as `Level.splay` has them.
export function splayed({ level, kind, rules }, thing, at, about) {
  const { grid, agent, looks } = level;
  const lifted = grid.map((row) => [...row]);
  const code = about.legend[about.objects[thing]];
  let where = null;
  if (thing !== "agent") {
    const there = cellsOf(grid, code);
    where = at ?? (there.length === 1 ? there[0] : null);
    if (!where || grid[where[1]][where[0]] !== code) throw new Error(`which ${thing}?`);
    lifted[where[1]][where[0]] = 0;
  }
  const free = uncovered({ grid: lifted, looks }).grid;
  const state = rules.build({ grid: lifted, agent, looks: carried(looks, where) }, kind);
  const here = agent.map(Math.floor);
  return rules.places(state)
    .filter((cell) => (String(cell) === String(here) ? thing === "agent" : free[cell[1]][cell[0]] === 0))
    .sort((one, two) => one[1] - two[1] || one[0] - two[0])
    .map((cell) => {
      const cells = lifted.map((row) => [...row]);
      if (thing !== "agent") cells[cell[1]][cell[0]] = code;
      const begin = thing === "agent" ? [cell[0] + 0.5, cell[1] + 0.5] : agent;
      const moved = where ? carried(looks, where, cell) : looks;
      return { cell, level: { grid: cells, agent: begin, looks: moved } };
    });
}
