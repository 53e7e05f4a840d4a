// Answers a page's questions without Python: rules, small networks and posteriors are computed here.
//
// The answers of `astray.lab.session`, in the same words. Questions that need Python are refused.

import { posterior } from "../agent/agency.js";
import { readNetwork, softmax } from "../agent/network.js";
import { noise, sample } from "../agent/noise.js";
import { readTable } from "../agent/table.js";
import { NEVER } from "../rules/common.js";
import { goals } from "../rules/constants.js";
import { exact, shiftOf } from "../level.js";
import { effects, played, snapshot, take, told } from "./episodes.js";
import { firstGoal, namedPlaces, waysPart } from "./goals.js";
import { drawn, read, rowsOf, splayed, whole } from "./levels.js";

const AT_ONCE = 16; // places that are computed before the page may draw
const { NEITHER, OTHER, TOGETHER } = goals;

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
    return kept(this.files, path, async () => {
      const response = await fetch(new URL(path, this.folder));
      if (!response.ok) throw new Error(`${path} is not there`);
      return kind === "json" ? response.json() : response.arrayBuffer();
    });
  }

  async *hello() {
    yield (this.about = await this.file("data/index.json"));
  }

  async *art({ game }) {
    yield await this.file(`data/art/${game}.json`);
  }

  async *level(message) {
    const { level, s, number, rules } = await this.world(message);
    yield {
      level, number, text: drawn(level, this.about.games[message.game].legend).join("\n"),
      problem: rules.problem(s), state: snapshot(s, rules),
    };
  }

  // The level of a message and the state that it begins in.
  async world({ game, variant, level, knobs = {} }) {
    const about = this.about.games[game];
    if (!about) throw new Error(`the game '${game}' needs Python: astray lab`);
    const { rules } = await import(`../${about.rules}`);
    if (!about.knobs[variant]) throw new Error(`unknown variant '${variant}' of ${game}`);
    let [given, kept] = [null, null];
    if (typeof level === "number") {
      const { levels } = await this.file(this.levelsOf(game, variant, knobs));
      kept = levels.find((one) => one.number === level);
      if (!kept) throw new Error(`This page has levels 0 to ${levels.length - 1} of it; others need Python: astray lab.`);
      given = { ...read(kept.text.split("\n"), about.legend), looks: exact(kept.looks) };
    } else if (typeof level === "string") {
      given = { ...read(rowsOf(level), about.legend), looks: {} };
    } else {
      given = { ...read(drawn(level, about.legend), about.legend), looks: level.looks };
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
    s.level = NEVER;
    if (kept) rules.number(s, kept);
    const looks = { ...given.looks };
    return { level: { game, grid: given.grid, agent: rules.centre(s), looks }, s, number: kept?.number ?? null, rules, kind };
  }

  // The file of the numbered levels of a variant under changed knobs, which are others: an agent's.
  levelsOf(game, variant, knobs) {
    const same = (own) => [own, knobs].every((one) => Object.keys(one).every((name) => own[name] === knobs[name]));
    if (same({})) return `data/levels/${game}/${variant}.json`;
    const found = Object.values(this.about.agents).find((one) => one.game === game && one.levels?.[variant] && same(one.knobs[variant]));
    if (found) return found.levels[variant];
    const told = Object.entries(knobs).map(([name, value]) => `${name} = ${value}`).join(", ");
    throw new Error(`This page has no numbered levels of ${variant} with ${told}; others need Python: astray lab.`);
  }

  async agentOf({ agent, game, mode = "sampled", seed = 0 }) {
    const about = this.about.agents[agent];
    if (!about) throw new Error(`unknown agent '${agent}'`);
    if (about.game !== game) throw new Error(`the agent '${agent}' plays ${about.game}, not ${game}`);
    const policyAndValue = await kept(this.loading, agent, async () => (about.table
      ? readTable((path, kind) => this.file(path, kind), about.table)
      : small(await this.file(`data/agents/${agent}.safetensors`, "bytes"))));
    const drawn = about.seed + seed;
    const act = (s, rules) => {
      const { policy } = policyAndValue(s, rules);
      return mode === "greedy" ? policy.indexOf(Math.max(...policy))
        : sample(policy, noise(drawn, s.level, s.time, policy.length));
    };
    return { policyAndValue, act };
  }

  async *fields(message) {
    const { rules, policyAndValue, s } = await this.at(message);
    const cells = rules.places(s);
    const count = this.about.games[message.game].actions.length;
    const [x, y] = [Math.floor(s.x), Math.floor(s.y)];
    const away = ([u, v]) => Math.abs(u - x) + Math.abs(v - y);
    cells.sort((one, two) => away(one) - away(two));
    for (let first = 0; first < cells.length; first += AT_ONCE) {
      const some = cells.slice(first, first + AT_ONCE);
      const answers = some.map((cell) => policyAndValue(rules.put(s, cell), rules));
      yield {
        cells: some, policy: answers.map((one) => one.policy), value: answers.map((one) => one.value),
        of: cells.length,
        ...(message.effects && !s.ended && { same: some.map((cell) => effects(rules, rules.put(s, cell), count)) }),
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
      take(episode, world.rules, agent.act(episode.states.at(-1), world.rules));
      if (episode.ended || k + 1 === steps || (k + 1) % 8 === 0) {
        yield told(episode, first, agent, world.rules);
        first = episode.states.length;
      }
    }
  }

  async *posterior(message) {
    const { s, rules } = await this.world(message);
    const game = this.about.games[message.game];
    const places = namedPlaces(game, this.shift(message), s, rules, message.game);
    const placed = Object.entries(places).filter(([, place]) => place);
    if (!placed.length) {
      throw new Error(`In this level, no goal is reached by going to one cell: ${Object.keys(places).join(", ")}.`);
    }
    const episode = played({ s, rules }, message.actions ?? []);
    let way = episode.states.map((one) => [Math.floor(one.x), Math.floor(one.y)]);
    const ends = placed.map(([, place]) => way.findIndex((cell) => String(cell) === String(place)))
      .filter((step) => step >= 0);
    if (ends.length) way = way.slice(0, Math.max(...ends) + 1);
    const { cells, rates } = posterior(rules.open(s), way);
    const goals = {};
    const rest = rates.map(() => 1);
    for (const [goal, place] of placed) {
      const g = cells.findIndex((cell) => String(cell) === String(place));
      if (g < 0) continue;
      goals[goal] = rates.map((row) => row[g]);
      goals[goal].forEach((rate, t) => { rest[t] -= rate; });
    }
    goals[OTHER] = rest.map((rate) => Math.max(rate, 0));
    yield { goals, agent: null, cells, rates };
  }

  shift(message) {
    const found = shiftOf(this.about, message);
    if (!found) throw new Error(`${message.game} must have a shift between goals for this`);
    return found;
  }

  // Known of mazes alone, whose goals are cells that the agent walks to; null elsewhere.
  async *distinguishes(message) {
    const { s, rules } = await this.world(message);
    const shift = this.shift(message);
    const told = [shift.intended, ...shift.proxies].map((goal) => rules.walks && rules.target(s, goal));
    const known = shift.proxies.length && told.every((place) => place);
    yield { distinguishes: known ? waysPart(rules.open(s), [s.x, s.y].map(Math.floor), told) : null };
  }

  async *splay(message) {
    const world = await this.world(message);
    const shift = this.shift(message);
    const events = this.about.games[message.game].goals;
    for (const goal of [shift.intended, ...shift.proxies]) {
      if (!events[goal]) throw new Error(`the goal '${goal}' is known only at the end of an episode`);
    }
    const levels = splayed(world, message.thing, message.cell, this.about.games[message.game]);
    for (const { level, cell } of levels) {
      const outcomes = {};
      for (let draw = 0; draw < (message.draws ?? 1); draw++) {
        const agent = await this.agentOf({ ...message, seed: (message.seed ?? 0) + draw });
        const begun = await this.world({ ...message, level });
        begun.s.level = levels.findIndex((one) => one.cell === cell) % TOGETHER;
        const episode = played(begun, []);
        const reached = () => firstGoal(episode.states.at(-1), shift, events);
        while (!episode.ended && reached() === NEITHER) {
          take(episode, begun.rules, agent.act(episode.states.at(-1), begun.rules));
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
    yield { planes: nested(data, shape) };
  }

  async *attribution(message) {
    if ((message.method ?? "occlusion") !== "occlusion") {
      throw new Error("without Python there is occlusion; gradients need it: astray lab");
    }
    const { rules, s, policyAndValue } = await this.at(message);
    if (!policyAndValue.network) throw new Error("this agent is not computed here: astray lab");
    const { shape, data } = rules.planes(s);
    const whole = policyAndValue.network.outputs({ shape, data }).value;
    const falls = Array.from(data, (what, k) => {
      if (!what) return 0;
      const without = data.slice();
      without[k] = 0;
      return whole - policyAndValue.network.outputs({ shape, data: without }).value;
    });
    yield { map: nested(falls, shape) };
  }

  // eslint-disable-next-line require-yield
  async *route() {
    throw new Error("the best way needs Python: astray lab");
  }
}

// Keeps the promise of `made` by its name, but not one that failed, as without a network.
function kept(promises, name, made) {
  if (!promises.has(name)) promises.set(name, made().catch((error) => { promises.delete(name); throw error; }));
  return promises.get(name);
}

const rest = () => new Promise((resolve) => { setTimeout(resolve, 0); });

function small(buffer) {
  const network = readNetwork(buffer);
  const policyAndValue = (s, rules) => {
    const { logits, value } = network.outputs(rules.planes(s));
    return { policy: softmax(logits), value };
  };
  policyAndValue.network = network;
  return policyAndValue;
}

function nested(data, [planes, height, width]) {
  return Array.from({ length: planes }, (_, c) => Array.from({ length: height }, (_, y) =>
    Array.from(data.slice((c * height + y) * width, (c * height + y + 1) * width))));
}
