// The lab's page: what is shown, and what is asked when something changes.
//
// It knows a level, an episode in it, and what an agent makes of both. Everything else is asked of
// an engine: a Python process, a notebook's kernel, or `engine/local.js`.

import { Editor } from "./editor.js";
import { exact, plain } from "./level.js";
import { fromLink, toLink } from "./link.js";
import { Panels } from "./panels.js";
import { Stage } from "./stage.js";
import { Pictures } from "./draw/pictures.js";
import { lookOf } from "./games/looks.js";

const IDLE = 8; // steps in one place after which an agent that was handed over to is stopped
const SOON = 1000; // milliseconds, after which a page that loads says so
const PLAYED_AT_ONCE = 400; // steps that an agent is handed over for

export class Lab {
  // root: the page's markup; links: whether the address follows what is shown; signal: of its end.
  constructor(root, engine, { links = true, signal } = {}) {
    Object.assign(this, { root, engine, links, signal });
    this.part = (name) => root.querySelector(`[data-lab="${name}"]`);
    this.fields = new Map(); // "x,y" -> {cell, policy, value}
    this.others = new Map(); // also, of what is compared with
    this.splay = new Map();
    Object.assign(this, { past: [], future: [], pictures: { __proto__: null }, now: 0 });
    this.stage = new Stage(this);
    this.panels = new Panels(this);
    this.editor = new Editor(this);
  }

  async begin() {
    this.engine.status = (what) => this.panels.status(what);
    const about = await this.tried(() => this.engine.ask({ kind: "hello" }));
    if (!about) return;
    this.about = about;
    this.address = location.hash;
    const start = { ...about.start, ...(this.links ? await fromLink(this.address, about) : {}) };
    this.agent = start.agent ?? "";
    this.game = start.game;
    this.variant = start.variant;
    this.panels.begin();
    await this.open(start.level ?? 0, start.wrong ?? "");
    globalThis.addEventListener("hashchange", () => this.follow(), { signal: this.signal });
    await this.follow(); // a link that came meanwhile
    this.part("main").inert = false; // before, nothing was shown that could be used
    this.panels.tour();
    this.ready = true;
  }

  async follow() {
    if (!this.links || location.hash === this.address) return;
    this.address = location.hash;
    const { wrong = "", level = 0, ...shown } = await fromLink(this.address, this.about);
    Object.assign(this, shown);
    this.panels.choices();
    await this.open(level, wrong);
  }

  // Return the result of `work`, or undefined if it fails; then the page says why.
  async tried(work) {
    try {
      return await work();
    } catch (error) {
      this.panels.problem(error.message);
      return undefined;
    }
  }

  // Ask; `add` hears each part of the answer, the last one too, which is returned.
  async #ask(question, add) {
    const last = await this.engine.ask(question, add);
    if (last) add(last);
    return last;
  }

  get look() {
    return lookOf(this.game);
  }

  // The actions that no arrow key stands for; single letters do nothing.
  get further() {
    const keys = /^(stay|(left|right)?-?(up|down)?)$/;
    return this.rules.actions.filter((name) => name.length > 1 && !keys.test(name));
  }

  get rules() {
    return this.about.games[this.game];
  }

  // The knobs that the agent was trained with, and that the variant has otherwise.
  get knobs() {
    return this.about.agents[this.agent]?.knobs[this.variant] ?? {};
  }

  // Fields of every question about the level.
  question(kind, more = {}) {
    const { game, variant, agent, knobs } = this;
    const level = more.level ?? this.number ?? plain(this.level);
    const steering = this.part("steered").checked ? this.steering : {};
    const { mode, seed } = this;
    return { kind, game, variant, knobs, level, agent, mode, seed, steering, ...more };
  }

  // The change of a layer that is described on the page.
  get steering() {
    const channels = this.part("channels").value.split(/[\s,]+/).filter(Boolean).map(Number);
    const what = this.part("change").value;
    const amount = Number(this.part("amount").value);
    return {
      what, layer: this.part("layers").value, ...(channels.length && what !== "vector" && { channels }),
      ...(what === "vector" && { coefficient: amount }), ...(what === "patch" && { value: amount }),
    };
  }

  get mode() {
    return this.part("mode").value;
  }

  get seed() {
    const seed = Math.trunc(Number(this.part("seed").value));
    return Math.min(Math.max(seed || 0, 0), 999);
  }

  // Show a level: a number, a drawing, or an object as `Level.to_json` has it. `wrong`, of a link:
  // what else was asked for and cannot be shown.
  async open(level, wrong = null) {
    const compiled = this.about.engine === "static" ? ""
      : " Code that is used for the first time is compiled: some 10 to 20 seconds of a free core.";
    const late = setTimeout(() => this.panels.status(`Loading.${compiled}`), SOON);
    return this.#opened(level, wrong).finally(() => { clearTimeout(late); this.panels.status("connected"); });
  }

  async #opened(level, wrong) {
    const mine = (this.opening = Symbol("level"));
    if (this.level?.game !== this.game) { // it is of the game that was there before
      this.#clear();
      this.broken = true;
    }
    let artless = "";
    const told = await this.tried(async () => {
      artless = await this.#art(this.game);
      return this.opening === mine && this.engine.ask(this.question("level", { level: exact(level) }));
    });
    if (this.opening !== mine || told === null) return false; // a newer one was asked for
    if (!told) { // instead of a link's or a new game's, another level of it, and what is wrong
      const said = this.part("problem").textContent;
      const first = wrong !== null || this.level?.game !== this.game;
      return first && level !== 0 && this.#opened(0, `${wrong ?? ""} ${said}`.trim());
    }
    this.#take({ ...told, problem: [wrong, artless, told.problem].filter(Boolean).join(" ") });
    this.original = { level: told.level, number: told.number };
    this.opened = this.variant;
    Object.assign(this, { past: [], future: [] });
    this.editor.leave();
    this.panels.level();
    await this.refresh();
    return true;
  }

  #clear() {
    for (const drawn of [this.fields, this.others, this.splay]) drawn.clear();
  }

  // Get the drawings of a game; return why there are none, if they cannot be had now.
  async #art(game) {
    if (this.pictures[game]?.images.size) return "";
    const found = await this.engine.ask({ kind: "art", slot: game, game }).catch(({ message }) => ({ pictures: {}, message }));
    if (found) this.pictures[game] = new Pictures(found.pictures, () => this.stage.redraw());
    return found?.message ?? "";
  }

  #take({ level, number, text, problem, state }) {
    Object.assign(this, { level, number, text, problem });
    this.broken = false;
    this.episode = { states: [state], actions: [], rewards: [], value: [], ended: false };
    this.now = 0;
    this.splay.clear();
    this.panels.problem(problem);
  }

  // Change the level, by hand; it is checked as all levels are. `first`: to be undone to here.
  async edit(level, first = true) {
    if (first) this.#remember();
    await this.#change(level, null);
  }

  #remember() {
    this.past.push({ level: this.level, number: this.number });
    this.future = [];
  }

  async #change(level, number) {
    const leaves = () => level.game !== this.game || this.opened !== this.variant;
    if (leaves()) return; // another is on its way
    Object.assign(this, { level, number });
    this.stage.redraw();
    this.panels.edited();
    const mine = (this.changing = Symbol("change"));
    try {
      const told = await this.engine.ask(this.question("level"));
      if (!told || this.changing !== mine || leaves()) return;
      this.#take(told);
      await this.refresh();
    } catch (error) {
      if (this.changing !== mine) return;
      this.broken = true;
      this.#clear();
      this.goals = null;
      this.#elsewhere();
      this.panels.problem(error.message);
      this.stage.redraw();
    }
  }

  undo = () => this.#swap(this.past, this.future);
  redo = () => this.#swap(this.future, this.past);

  // Change to the last level in `from`, and keep the present one in `to`.
  async #swap(from, to) {
    const other = from.pop();
    if (!other) return;
    to.push({ level: this.level, number: this.number });
    this.editor.leave();
    await this.#change(other.level, other.number);
  }

  async restore() {
    if (!this.original) return; // before the first level
    this.#remember();
    this.editor.leave();
    await this.#change(this.original.level, this.original.number);
  }

  // Ask anew for all that depends on level, agent and episode.
  async refresh() {
    this.#elsewhere();
    this.stage.redraw();
    this.panels.edited();
    if (this.links) {
      const mine = (this.linking = Symbol("address"));
      const address = await toLink(this);
      if (this.linking === mine && this.address === location.hash) { // else a newer link is to be followed
        if (address !== this.address) history.replaceState(null, "", address);
        this.address = address;
      }
    }
    await Promise.all([
      this.play(this.episode.actions.slice(0, this.now), 0), this.think(), this.#distinguishes(),
    ]);
  }

  // Whether this level distinguishes the goals; engines that cannot say are ignored.
  async #distinguishes() {
    const mine = (this.telling = Symbol("level"));
    this.panels.distinguishes(null);
    if (!this.panels.shift || this.rules.real_time) return;
    const told = await this.engine.ask(this.question("distinguishes")).catch(() => null);
    if (told && this.telling === mine) this.panels.distinguishes(told.distinguishes);
  }

  // The arrows, in the state that is shown; and those of what is compared with.
  async think() {
    await Promise.all([
      this.#arrows(this.fields, "own", this.#asked()).then(() => this.panels.compared()),
      this.#compare(), this.panels.look(),
    ]);
  }

  get actions() {
    return this.episode.actions.slice(0, this.now);
  }

  async #arrows(fields, slot, question) {
    if (!question.agent) { fields.clear(); this.stage.redraw(); return; }
    let first = true;
    const add = ({ cells, policy, value, same }) => {
      if (first) fields.clear();
      first = false;
      cells.forEach((cell, k) => {
        fields.set(String(cell), { cell, policy: policy[k], value: value[k], same: same?.[k] });
      });
      this.stage.redraw();
    };
    try {
      await this.#ask({ ...question, slot }, add);
    } catch (error) {
      fields.clear();
      if (slot === "own" || !this.problem) this.panels.problem(error.message);
      this.stage.redraw();
    }
  }

  // The question for arrows; where they are compared, it says which actions do the same.
  #asked() {
    const effects = this.part("compare").value !== "";
    return this.question("fields", { actions: this.actions, ...(effects && { effects }) });
  }

  async #compare() {
    const what = this.part("compare").value;
    const question = this.#asked();
    if (what === "level") {
      const { level, number } = this.original;
      Object.assign(question, { level: number ?? plain(level), actions: [] });
    } else if (what.startsWith("agent ")) {
      question.agent = what.slice(6);
    } else if (what === "change") {
      question.steering = this.steering;
    } else {
      question.agent = ""; // there are no arrows, then
    }
    await this.#arrows(this.others, "other", question);
    this.panels.compared();
  }

  // Play actions from the beginning, and let the agent go on for so many steps.
  async play(actions, steps) {
    const question = this.question("play", { actions, steps });
    const { episode } = this;
    const add = (part) => {
      if (episode !== this.episode) return; // it is of a level that was changed meanwhile
      episode.states.splice(part.first, Infinity, ...part.states);
      episode.value.splice(part.first, Infinity, ...(part.value ?? []));
      const from = Math.max(part.first - 1, 0);
      episode.actions.splice(from, Infinity, ...part.actions);
      episode.rewards.splice(from, Infinity, ...part.rewards);
      Object.assign(episode, { ended: part.ended, terminated: part.terminated });
      this.show(steps ? this.now : episode.actions.length);
    };
    const done = await this.tried(() => this.#ask(question, add));
    if (done) await this.#pursue();
    return done;
  }

  async #pursue() {
    this.goals = this.goalless = null;
    if (this.agent && !this.rules.real_time && this.rules.solver) {
      const question = this.question("posterior", { actions: this.episode.actions });
      try {
        const found = await this.engine.ask(question); // before a step only whether it can be told
        if (this.episode.actions.length) this.goals = found ?? this.goals;
      } catch (error) {
        this.goalless = error.message;
      }
    }
    this.panels.pursued();
    this.stage.redraw();
  }

  // The person's action, from the state that is shown on.
  async act(name) {
    const action = this.rules.actions.indexOf(name);
    const over = this.episode.ended && this.now === this.episode.actions.length;
    if (this.broken || action < 0 || over) return;
    this.#stop();
    const done = await this.play([...this.actions, action], 0);
    if (done) await this.go(this.now);
  }

  async step() {
    if (!this.agent || this.broken) return;
    this.#stop();
    const now = this.now;
    await this.play(this.actions, 1);
    await this.go(Math.min(now + 1, this.episode.actions.length));
  }

  // Let the agent play on, and show it step by step.
  async handOver() {
    const stops = this.running;
    if (stops) this.#stop();
    if (stops || !this.agent || this.broken) return;
    const mine = (this.running = Symbol("run"));
    this.panels.played();
    const whole = this.play(this.actions, PLAYED_AT_ONCE).then(() => { this.known = mine; });
    while (this.running === mine) {
      await new Promise((resolve) => { setTimeout(resolve, Number(this.part("speed").value)); });
      if (this.#idles()) {
        await whole;
        await this.play(this.actions, 0); // neither reports the rest
        break;
      }
      if (this.now < this.episode.actions.length) this.show(this.now + 1);
      else if (this.known === mine) break;
    }
    await whole;
    if (this.running === mine) this.#stop();
    await this.think();
  }

  // Whether an agent has stood in its place for a while, and changed nothing there.
  #idles() {
    const last = this.episode.states.slice(Math.max(this.now - IDLE, 0), this.now + 1);
    const seen = new Set(last.map((s) => JSON.stringify([s.x, s.y, s.grid, s.picture])));
    return !this.rules.real_time && last.length > IDLE && seen.size === 1;
  }

  #stop() {
    this.running = null;
    this.panels.played();
  }

  // Show the state after so many steps; `think` is asked for once it stays.
  show(step) {
    this.now = Math.min(Math.max(step, 0), this.episode.actions.length);
    this.#elsewhere();
    this.panels.routed();
    this.panels.played();
    this.panels.pursued();
    this.stage.redraw();
  }

  // Forget what began in another state, or was asked there.
  #elsewhere() {
    this.way = null;
    this.here = Symbol("state");
    this.panels.unread();
  }

  async go(step) {
    this.panels.problem(this.problem); // of another state
    this.show(step);
    await this.think();
  }

  async askSplay() {
    const [thing, at] = this.part("thing").value.split("@");
    const cell = at ? at.split(",").map(Number) : null;
    const draws = Number(this.part("draws").value);
    this.splay.clear();
    const mine = (this.splaying = Symbol("splay"));
    const add = ({ cells, outcomes, of }) => {
      if (this.splaying !== mine) return; // it was of another level, agent or mode
      cells.forEach((where, k) => {
        this.splay.set(String(where), { cell: where, outcomes: outcomes[k] });
      });
      this.panels.splayed(of);
      this.stage.redraw();
    };
    this.panels.status("Playing …"); // a large level's first places may take a minute
    await this.tried(() => this.#ask(this.question("splay", { thing, cell, draws }), add));
    this.panels.status("connected");
  }

  async askReading() {
    const question = this.question("reading", { actions: this.actions, layer: this.part("probed").value });
    this.panels.status("Fitting probes …");
    const { here } = this;
    await this.tried(() => this.#ask(question, (part) => here === this.here && this.panels.read(part)));
    this.panels.status("connected");
  }

  async askRoute() {
    const goal = this.part("goal").value;
    const question = this.question("route", { goal, actions: this.actions });
    const { here } = this;
    const way = await this.tried(() => this.engine.ask(question));
    if (here !== this.here) return;
    this.way = way;
    this.panels.routed();
    this.stage.redraw();
  }
}
