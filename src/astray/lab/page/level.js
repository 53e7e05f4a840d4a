// Levels as data.

// The cells [x, y] of a grid that hold a code, row by row.
export function cellsOf(grid, code) {
  const found = [];
  grid.forEach((row, y) => row.forEach((what, x) => what === code && found.push([x, y])));
  return found;
}

// The fields of a level that it is built from.
export function plain(level) {
  const { grid, agent, looks } = exact(level);
  return { grid, agent, looks };
}

// A level, or a part of it; throws where JSON lost digits in this browser.
export function exact(level) {
  if (Number.isInteger(level) && !Number.isSafeInteger(level)) {
    throw new Error(`a level's whole numbers must be below 2 ** 53 here, as browsers round larger ones; got ${level}`);
  }
  if (level && typeof level === "object") Object.values(level).forEach(exact);
  return level;
}

// The shift of an agent, or else of a variant; undefined where the game has none for it.
export function shiftOf({ agents, games }, { agent, game, variant }) {
  const { shifts } = games[game];
  return shifts[agents[agent]?.shift] ?? Object.values(shifts).find((s) => [s.train, s.test].includes(variant));
}

// Looks of single cells go where their objects go: from one cell to another, or away.
export function carried(looks, from, to = null) {
  if (!Array.isArray(looks?.details)) return looks;
  const is = ([x, y], cell) => cell && x === cell[0] && y === cell[1];
  const details = looks.details.filter((one) => is(one, from) || !is(one, to))
    .flatMap((one) => (is(one, from) ? (to ? [[...to, ...one.slice(2)]] : []) : [one]))
    .sort((one, two) => one[1] - two[1] || one[0] - two[0]);
  return { ...looks, details };
}
