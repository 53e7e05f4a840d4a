// Answers a page's questions without Python: rules, small networks and posteriors are computed here.
//
// What `astray.lab.session` answers, in the same words. What only Python can do says so.

import { posterior } from "../mind/agency.js";
import { readNetwork, softmax } from "../mind/network.js";
import { noise, sample } from "../mind/noise.js";
import { readTable } from "../mind/table.js";
import { NEVER, WALL, advance, cellsOf } from "../rules/common.js";
import { rules as coinrun } from "../rules/coinrun.js";
import { rules as keys } from "../rules/keys.js";
import { rules as maze } from "../rules/maze.js";

const RULES = { coinrun, keys, maze };
const AT_ONCE = 16; // places that are computed before the page may draw
const [TOP, PERMEABLE] = [2, 8]; // of CoinRun's cells, beside WALL
const NEITHER = "neither";
const OTHER = "another cell";

export class LocalEngine {
  // folder: the address of the exported files, that of the page.
  constructor(folder) {
    this.folder = folder;
    this.files = new Map();
    this.latest = new Map();
    this.loading = new Map();
    this.status = () => {};
  }

  // The last part of the answer; `heard` gets those before it. null where a newer question came.
  async ask(message, heard = () => {}) {
    const slot = `${message.kind} ${message.slot ?? ""}`;
    const mine = Symbol(slot);
    this.latest.set(slot, mine);
    await rest();
    let last = null;
    for await (const part of this[message.kind](message)) {
      if (this.latest.get(slot) !== mine) return null;
      if (last) heard(last);
      last = part;
      await rest();
    }
    return this.latest.get(slot) === mine ? { ...last, done: true } : null;
  }

  async file(path, kind = "json") {
    if (!this.files.has(path)) {
      this.files.set(path, (async () => {
        const response = await fetch(new URL(path, this.folder));
        if (!response.ok) throw new Error(`${path} is not there`);
        return kind === "json" ? response.json() : response.arrayBuffer();
      })());
    }
    return this.files.get(path);
  }

  async *hello() {
    this.about = await this.file("data/index.json");
    yield this.about;
  }

  async *art({ game }) {
    yield await this.file(`data/art/${game}.json`);
  }

  async *level(message) {
    const { level, s, number } = await this.world(message);
    yield {
      level, number, text: textOf(level, this.about.games[message.game].legend),
      problem: RULES[message.game].problem(level, s), state: snapshot(s),
    };
  }

  // The level of a message and the state that it begins in.
  async world({ game, variant, level, agent, knobs = {} }) {
    const rules = RULES[game];
    if (!rules) throw new Error(`the game '${game}' needs Python: astray lab`);
    const about = this.about.games[game];
    if (!about.knobs[variant]) throw new Error(`unknown variant '${variant}' of ${game}`);
    let [given, number] = [level, null];
    if (typeof level === "number") {
      const own = this.about.agents[agent]?.levels?.[variant]; // of an agent with knobs of its own
      const { levels } = await this.file(own ?? `data/levels/${game}-${variant}.json`);
      const kept = levels.find((one) => one.number === level);
      if (!kept) throw new Error(`without Python there are levels 0 to ${levels.length - 1} of this`);
      number = level;
      given = { ...read(kept.text, about.legend), looks: kept.looks };
    } else if (typeof level === "string") {
      given = { ...read(level, about.legend), looks: {} };
    }
    const kind = { ...about.knobs[variant], ...knobs };
    if (kind.world && (given.grid.length !== kind.world || given.grid[0].length !== kind.world)) {
      throw new Error(
        `the level is ${given.grid[0].length} x ${given.grid.length} cells; the variant's world ` +
        `is ${kind.world} a side`,
      );
    }
    if (game === "coinrun") given = whole(given);
    const s = rules.build(given, kind);
    s.level = number ?? 0;
    const looks = { ...given.looks };
    return { level: { game, grid: given.grid, agent: [s.x, s.y], looks }, s, number, rules };
  }

  async agentOf({ agent, game, mode = "sampled", seed = 0 }) {
    const about = this.about.agents[agent];
    if (!about) throw new Error(`unknown agent '${agent}'`);
    if (about.game !== game) throw new Error(`the agent '${agent}' plays ${about.game}, not ${game}`);
    if (!this.loading.has(agent)) {
      this.loading.set(agent, about.table
        ? readTable((path, kind) => this.file(path, kind), about.table)
        : this.file(`data/agents/${agent}.safetensors`, "bytes").then(small));
    }
    const judge = await this.loading.get(agent);
    const drawn = about.seed + seed;
    const act = (s, policy) => mode === "greedy"
      ? policy.indexOf(Math.max(...policy))
      : sample(policy, noise(drawn, s.level, s.time, policy.length));
    return { judge, act };
  }

  async *fields(message) {
    const { rules, judge, s } = await this.at(message);
    const cells = rules.places(s);
    const [x, y] = [Math.floor(s.x), Math.floor(s.y)];
    const away = ([u, v]) => Math.abs(u - x) + Math.abs(v - y);
    cells.sort((one, two) => away(one) - away(two));
    for (let first = 0; first < cells.length; first += AT_ONCE) {
      const some = cells.slice(first, first + AT_ONCE);
      const judged = some.map((cell) => judge(rules.put(s, cell), rules));
      yield {
        cells: some, policy: judged.map((one) => one.policy), value: judged.map((one) => one.value),
        of: cells.length,
      };
    }
  }

  // World, agent and the state after a message's actions.
  async at(message) {
    const world = await this.world(message);
    const agent = await this.agentOf(message);
    const { states } = played(world, message.actions ?? []);
    return { ...world, ...agent, s: states.at(-1) };
  }

  async *play(message) {
    const world = await this.world(message);
    const agent = message.agent ? await this.agentOf(message) : null;
    const episode = played(world, message.actions ?? []);
    yield told(episode, 0, agent, world.rules);
    const steps = agent ? (message.steps ?? 0) : 0;
    for (let first = episode.states.length, k = 0; k < steps && !episode.ended; k++) {
      const { policy } = agent.judge(episode.states.at(-1), world.rules);
      take(episode, world.rules, agent.act(episode.states.at(-1), policy));
      if (episode.ended || k + 1 === steps || (k + 1) % 8 === 0) {
        yield told(episode, first, agent, world.rules);
        first = episode.states.length;
      }
    }
  }

  async *posterior(message) {
    const { level, s, rules } = await this.world(message);
    const game = this.about.games[message.game];
    const places = namedPlaces(game, this.shift(message), s);
    const episode = played({ level, s, rules }, message.actions ?? []);
    let way = episode.states.map((one) => [Math.floor(one.x), Math.floor(one.y)]);
    const ends = Object.values(places)
      .map((place) => way.findIndex((cell) => String(cell) === String(place)))
      .filter((step) => step >= 0);
    if (ends.length) way = way.slice(0, Math.max(...ends) + 1);
    const { cells, shares } = posterior(level.grid, way);
    const goals = {};
    const rest = shares.map(() => 1);
    for (const [goal, place] of Object.entries(places)) {
      const g = cells.findIndex((cell) => String(cell) === String(place));
      if (g < 0) continue;
      goals[goal] = shares.map((row) => row[g]);
      goals[goal].forEach((share, t) => { rest[t] -= share; });
    }
    goals[OTHER] = rest.map((share) => Math.max(share, 0));
    yield { goals, agent: null, cells, shares };
  }

  shift({ agent, game, variant }) {
    const { shifts } = this.about.games[game];
    const named = shifts[this.about.agents[agent]?.shift];
    const found = Object.values(shifts).find((s) => s.train === variant || s.test === variant);
    if (!named && !found) throw new Error(`${game} must have a shift between goals for this`);
    return named ?? found;
  }

  async *splay(message) {
    const world = await this.world(message);
    const shift = this.shift(message);
    const events = this.about.games[message.game].goals;
    const levels = splayed(world, message.thing, message.cell, this.about.games[message.game]);
    for (const { level, cell } of levels) {
      const outcomes = {};
      for (let draw = 0; draw < (message.draws ?? 1); draw++) {
        const agent = await this.agentOf({ ...message, seed: (message.seed ?? 0) + draw });
        const begun = await this.world({ ...message, level });
        begun.s.level = levels.findIndex((one) => one.cell === cell) % 16; // as Python numbers them
        const episode = played(begun, []);
        const reached = () => firstGoal(episode.states.at(-1), shift, events);
        while (!episode.ended && reached() === NEITHER) {
          const { policy } = agent.judge(episode.states.at(-1), begun.rules);
          take(episode, begun.rules, agent.act(episode.states.at(-1), policy));
          episode.states.splice(0, episode.states.length - 1);
        }
        outcomes[reached()] = (outcomes[reached()] ?? 0) + 1;
      }
      yield { cells: [cell], outcomes: [outcomes], of: levels.length };
    }
  }

  async *view(message) {
    const { rules, s } = await this.at(message);
    const { shape, data } = rules.planes(s);
    yield { planes: nested(data, shape), largest: null };
  }

  async *attribution(message) {
    if ((message.method ?? "occlusion") !== "occlusion") {
      throw new Error("without Python there is occlusion; gradients need it: astray lab");
    }
    const { rules, s, judge } = await this.at(message);
    if (!judge.network) throw new Error("this agent is not computed here: astray lab");
    const { shape, data } = rules.planes(s);
    const whole = judge.network.outputs({ shape, data }).value;
    const falls = Array.from(data, (what, k) => {
      if (!what) return 0;
      const without = data.slice();
      without[k] = 0;
      return whole - judge.network.outputs({ shape, data: without }).value;
    });
    yield { map: nested(falls, shape) };
  }

  // eslint-disable-next-line require-yield
  async *route() {
    throw new Error("the best way needs Python: astray lab");
  }
}

const rest = () => new Promise((resolve) => { setTimeout(resolve, 0); });

function small(buffer) {
  const network = readNetwork(buffer);
  const judge = (s, rules) => {
    const { logits, value } = network.outputs(rules.planes(s));
    return { policy: softmax(logits), value };
  };
  judge.network = network;
  return judge;
}

function played({ s, rules }, actions) {
  const episode = { states: [rules.copy(s)], actions: [], rewards: [], terminated: false, ended: false };
  for (const action of actions) take(episode, rules, action);
  return episode;
}

function take(episode, rules, action) {
  if (episode.ended) throw new Error(`the episode has ended after ${episode.actions.length} steps`);
  const s = rules.copy(episode.states.at(-1));
  const { reward, terminated } = advance(rules, s, action);
  episode.states.push(s);
  episode.actions.push(action);
  episode.rewards.push(reward);
  Object.assign(episode, { terminated, ended: s.ended });
}

function told(episode, first, agent, rules) {
  const states = episode.states.slice(first);
  const judged = agent ? states.map((s) => agent.judge(s, rules)) : [];
  return {
    first, states: states.map(snapshot), actions: episode.actions.slice(Math.max(first - 1, 0)),
    rewards: episode.rewards.slice(Math.max(first - 1, 0)), terminated: episode.terminated,
    ended: episode.ended,
    ...(agent && { policy: judged.map((j) => j.policy), value: judged.map((j) => j.value) }),
  };
}

// A state without what does not move.
export function snapshot(s) {
  const { cell, thing, draws, trail_x: trail, ...fields } = s;
  return structuredClone(fields);
}

function namedPlaces(game, shift, s) {
  const [places, events] = [{}, new Set()];
  for (const goal of [shift.intended, ...shift.proxies, ...Object.keys(game.goals)]) {
    const event = game.goals[goal];
    const place = event.replace("reached_", "");
    if (!(`${place}_x` in s) || game.real_time) {
      throw new Error(`${game.about.split(" ")[1]} has no cell for the goal '${goal}'; maze has`);
    }
    if (events.has(event)) continue;
    if (s[`${place}_x`] !== NEVER) places[goal] = [s[`${place}_x`], s[`${place}_y`]];
    events.add(event);
  }
  return places;
}

function firstGoal(s, shift, events) {
  const reached = [shift.intended, ...shift.proxies].filter((goal) => s[events[goal]] !== NEVER);
  return reached.reduce((best, goal) => best === NEITHER || s[events[goal]] < s[events[best]]
    ? goal : best, NEITHER);
}

// A level for every place of a thing, as `Level.splay` has them.
function splayed({ level, s, rules }, thing, at, about) {
  const { grid, agent, looks } = level;
  const lifted = grid.map((row) => [...row]);
  const code = about.legend[about.objects[thing]];
  if (thing !== "agent") {
    const where = at ?? cellsOf(grid, code)[0];
    if (!where || grid[where[1]][where[0]] !== code) throw new Error(`which ${thing}?`);
    lifted[where[1]][where[0]] = 0;
  }
  const state = rules.build({ grid: lifted, agent, looks }, { ...s, ...knobsOf(s) });
  const here = agent.map(Math.floor);
  return rules.places(state).filter((cell) => String(cell) !== String(here) || thing === "agent")
    .filter(([x, y]) => lifted[y][x] === 0)
    .sort((one, two) => one[1] - two[1] || one[0] - two[0])
    .map((cell) => {
      const cells = lifted.map((row) => [...row]);
      if (thing !== "agent") cells[cell[1]][cell[0]] = code;
      const begin = thing === "agent" ? [cell[0] + 0.5, cell[1] + 0.5] : agent;
      return { cell, level: { grid: cells, agent: begin, looks } };
    });
}

// Only places are wanted of the state, so that its looks may be any.
const knobsOf = () => ({
  goal_shape: "none", goal_colour: "none", other_shape: "dish", other_colour: "none",
  inventory: "hidden", walls: "sand",
});

function nested(data, [planes, height, width]) {
  return Array.from({ length: planes }, (_, c) => Array.from({ length: height }, (_, y) =>
    Array.from(data.slice((c * height + y) * width, (c * height + y + 1) * width))));
}

// A drawing as cells, rows from the lowest up, in the words of `Level.from_text`.
function read(text, legend) {
  const lines = text.replace(/\r/g, "").split("\n").filter((line) => !line.startsWith(";"));
  const rows = lines.map((line) => line.trim()).filter(Boolean).reverse();
  const lengths = new Set(rows.map((row) => row.length));
  if (lengths.size !== 1) {
    throw new Error(`a level's rows are equally long; these have [${rows.map((r) => r.length)}]`);
  }
  const agents = [];
  const grid = rows.map((row, y) => [...row].map((char, x) => {
    if (char === "@") agents.push([x, y]);
    const code = char === "@" ? legend["."] : legend[char];
    if (code === undefined) {
      const there = [...Object.keys(legend), "@"].join(" ");
      throw new Error(`unknown '${char}' at cell (${x}, ${y}); there are: ${there}`);
    }
    return code;
  }));
  if (agents.length !== 1) throw new Error(`a level has one '@', the agent; this has ${agents.length}`);
  return { grid, agent: agents[0] };
}

export function textOf({ grid, agent }, legend) {
  const chars = Object.fromEntries(Object.entries(legend).map(([char, code]) => [code, char]));
  const rows = grid.map((row) => row.map((code) => chars[code]));
  rows[Math.floor(agent[1])][Math.floor(agent[0])] = "@";
  return rows.map((row) => row.join("")).reverse().join("\n");
}

// A smaller level of CoinRun in the lower left of the whole world, walls around it.
function whole(level) {
  const [side, wide, high] = [64, level.grid[0].length, level.grid.length];
  if (Math.max(wide, high) > side) {
    throw new Error(`the level is ${wide} x ${high} cells; it is at most ${side} a side`);
  }
  const grid = Array.from({ length: side }, (_, y) => Array.from({ length: side }, (_, x) =>
    level.grid[y]?.[x] ?? 1));
  const looks = { ...level.looks };
  looks.end ??= endOf(grid);
  looks.permeable ??= grid[looks.end[1]].filter((what) => what === PERMEABLE).length;
  return { ...level, grid, looks };
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
