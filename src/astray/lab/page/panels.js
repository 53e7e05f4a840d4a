// Panels around the world: choices, sentences, charts.

import { drawPosterior, stepAt } from "./draw/charts.js";
import { goalColours, heat, signed, words } from "./draw/colours.js";
import { meanWay, rateOfWays } from "./draw/arrows.js";
import { drawSight } from "./draw/sight.js";
import { save } from "./files.js";
import { cellsOf, plain, shiftOf } from "./level.js";
import { bar, capital, counted, fillTable, keyed, made, named, options, percent, round, rounded } from "./parts.js";
import { levels } from "./rules/constants.js";
import { showTimeline } from "./timeline.js";

const NAMES = {
  "1,0": "right", "-1,0": "left", "0,1": "up", "0,-1": "down", "0,0": "stays", "1,1": "right and up",
  "-1,1": "left and up", "1,-1": "right and down", "-1,-1": "left and down",
};

// Total variation between the policies of two agents in a place; actions that do the same in both
// are one.
function variation(one, other) {
  const sums = new Map();
  one.policy.forEach((chance, k) => {
    const effect = `${one.same[k]} ${other.same[k]}`;
    sums.set(effect, (sums.get(effect) ?? 0) + chance - other.policy[k]);
  });
  return [...sums.values()].reduce((sum, change) => sum + Math.abs(change) / 2, 0);
}

export class Panels {
  constructor(lab) {
    this.lab = lab;
    this.part = lab.part;
  }

  // Fill what depends on what there is; hear what is chosen.
  begin() {
    const { lab, part } = this;
    const hear = (name, what, work) => part(name).addEventListener(what, work);
    this.choices();
    hear("agent", "change", () => this.#agent(part("agent").value));
    hear("variant", "change", () => this.#variant(part("variant").value));
    hear("number", "change", () => lab.open(this.#number()));
    for (const [name, by] of [["previous", -1], ["next", 1]]) hear(name, "click", () => this.#to(Math.max(this.#number() + by, 0)));
    hear("theme", "click", () => this.#theme());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw(), { signal: lab.signal });
    for (const name of ["undo", "redo", "restore"]) hear(name, "click", () => lab[name]());
    hear("once", "click", () => lab.step());
    hear("hand", "click", () => lab.handOver());
    for (const [name, by] of [["rewind", -Infinity], ["back", -1], ["forth", 1]]) hear(name, "click", () => lab.go(lab.now + by));
    hear("scrub", "input", () => lab.show(Number(part("scrub").value)));
    hear("scrub", "change", () => lab.go(Number(part("scrub").value)));
    hear("seed", "change", () => { part("seed").value = lab.seed; });
    for (const name of ["mode", "seed", "steered"]) hear(name, "change", () => lab.refresh());
    for (const name of ["layer", "heat", "zoom"]) hear(name, "change", () => lab.stage.redraw());
    hear("compare", "change", () => lab.think());
    for (const name of ["layers", "change", "amount", "channels"]) {
      hear(name, "change", () => {
        part("compare").value = "change";
        lab.think();
        if (part("steered").checked) lab.refresh();
      });
    }
    hear("reading", "click", () => lab.askReading());
    hear("splay", "click", () => lab.askSplay());
    hear("unsplay", "click", () => this.#unsplay());
    hear("route", "click", () => lab.askRoute());
    hear("unroute", "click", () => { lab.way = null; this.routed(); lab.stage.redraw(); });
    hear("sight", "toggle", () => this.look());
    hear("method", "change", () => this.look());
    hear("taken", "toggle", () => this.#toAgent());
    for (const name of ["timeline", "posterior"]) {
      hear(name, "click", (event) => lab.go(stepAt(event.target, event.offsetX, this.last)));
    }
    for (const name of ["link", "png", "gif", "json", "read"]) {
      hear(name, "click", () => lab.tried(() => save[name](lab)));
    }
    new ResizeObserver(() => { this.played(); this.pursued(); }).observe(part("timeline").parentElement);
    const { note, engine } = lab.about;
    part("zoom").checked = lab.root.clientWidth < 600; // the whole would be too small to see
    part("way").hidden = engine === "static"; // what needs Python is not offered there
    part("link").hidden = !lab.links; // a notebook's address shows no level
    for (const option of part("method").options) {
      option.hidden = engine === "static" && option.value.includes("gradients");
    }
    part("offline").hidden = !note;
    part("offline").textContent = note ?? "";
  }

  status(what) {
    const line = this.part("status");
    line.classList.toggle("lost", what === "lost");
    line.textContent = {
      connected: "",
      lost: "Not connected: the lab's process has ended or is busy. Trying again; nothing here is lost.",
    }[what] ?? what;
  }

  get shift() {
    return shiftOf(this.lab.about, this.lab);
  }

  get last() {
    return this.lab.episode.actions.length;
  }

  // The agents, levels, tools and things that may be chosen now.
  choices() {
    const { lab, part } = this;
    const { about, game } = lab;
    const agents = Object.entries(about.agents).map(([name, { game: plays }]) => [name, `${name} (${plays})`]);
    const none = Object.keys(about.games).map((name) => [`none ${name}`, `no agent (${name})`]);
    const broken = Object.entries(about.broken).map(([name, why]) => [`broken ${name}`, `${name} is broken: ${why}`, true]);
    options(part("agent"), [...agents, ...none, ...broken], lab.agent || `none ${game}`);
    const seen = about.agents[lab.agent]?.variants ?? Object.keys(lab.rules.variants);
    options(part("variant"), seen.map((name) => [name, `${name}: ${lab.rules.variants[name]}`]), lab.variant);
    this.#tools();
    this.#acts();
    lab.root.classList.toggle("alone", !lab.agent);
    const others = Object.entries(about.agents)
      .filter(([name, a]) => name !== lab.agent && a.game === game && a.variants.includes(lab.variant));
    const layers = Object.entries(about.agents[lab.agent]?.layers ?? {});
    part("steering").hidden = !layers.length;
    const late = layers.findLast(([name]) => name.includes("relu") || name.includes("residual"));
    options(part("layers"), layers.map(([name, shape]) => [name, `${name} (${shape.join(" x ")})`]),
      part("layers").value || late?.[0]);
    options(part("probed"), layers.map(([name]) => [name, name]), part("probed").value || late?.[0]);
    part("probing").hidden = !layers.length || !lab.rules.labels;
    this.unread();
    options(part("compare"), [
      ["", "nothing"], ["level", "the level as it was"],
      ...others.map(([name]) => [`agent ${name}`, `agent ${name}`]),
      ...(layers.length ? [["change", "the network changed (below)"]] : []),
    ], part("compare").value);
    part("posterior").parentElement.hidden = lab.rules.real_time;
    part("heat").querySelector("[value=goals]").hidden = lab.rules.real_time;
    part("zoomed").hidden = !lab.look.view;
  }

  // The objects, first the intended goal's.
  #objects() {
    const { lab } = this;
    const aim = (name) => named(lab, name) === this.shift?.intended;
    return Object.keys(lab.rules.objects).sort((one, other) => aim(other) - aim(one));
  }

  #tools() {
    const { lab } = this;
    const knobs = { ...lab.rules.knobs[lab.variant], ...lab.knobs };
    const objects = Object.keys(lab.rules.objects).filter((name) => lab.look.has?.(name, knobs) ?? true);
    const tools = [["hand", "Move"], ["wall", "Wall"], ...objects.slice(0, 4)
      .map((name) => [name, capital(named(lab, name))])];
    if (!tools.some(([name]) => name === lab.editor.tool)) lab.editor.tool = "hand";
    const buttons = tools.map(([name, text]) => made("button", { onclick: () => hold(name) }, text));
    const hold = (held) => {
      lab.editor.tool = held;
      tools.forEach(([name], k) => buttons[k].setAttribute("aria-pressed", String(name === held)));
    };
    tools.forEach(([name], k) => { buttons[k].dataset.tool = name; });
    hold(lab.editor.tool);
    this.part("tools").replaceChildren(...buttons);
  }

  // Buttons for actions that no arrow key stands for: pick up, drop.
  #acts() {
    const { lab } = this;
    this.part("acts").replaceChildren(...lab.further.map((name, k) =>
      made("button", { title: `${name} (${k + 1})`, onclick: () => lab.act(name) }, capital(name))));
  }

  async #agent(value) {
    const { lab } = this;
    const before = lab.game;
    const knobs = JSON.stringify(lab.knobs);
    const [none, game] = value.split(" ");
    if (none === "none" && game) Object.assign(lab, { agent: "", game });
    else Object.assign(lab, { agent: value, game: lab.about.agents[value].game });
    const fits = lab.about.agents[lab.agent]?.variants ?? Object.keys(lab.rules.variants);
    const same = lab.game === before && fits.includes(lab.variant);
    if (!same) lab.variant = lab.about.agents[lab.agent]?.test ?? fits[0];
    this.part("compare").value = "";
    this.choices();
    if (!same) await lab.open(0);
    else if (JSON.stringify(lab.knobs) === knobs) await lab.refresh();
    else await lab.open(lab.number ?? plain(lab.level), ""); // under other knobs it is another level
  }

  async #variant(variant) {
    const { lab } = this;
    lab.variant = variant;
    this.choices();
    await lab.open(lab.number ?? plain(lab.level), ""); // which keeps a drawn one if it can
  }

  #number() {
    const number = Math.trunc(Number(this.part("number").value));
    return Math.min(Math.max(number || 0, 0), levels.MOST - 1);
  }

  #to(number) {
    this.part("number").value = number;
    this.lab.open(number);
  }

  #theme() {
    const { root } = this.lab;
    const dark = root.classList.contains("dark") ||
      (!root.classList.contains("light") && matchMedia("(prefers-color-scheme: dark)").matches);
    root.classList.toggle("dark", !dark);
    root.classList.toggle("light", dark);
    this.redraw();
  }

  redraw() {
    this.played();
    this.pursued();
    this.lab.stage.redraw();
  }

  level() {
    const { lab, part } = this;
    this.choices();
    if (lab.number !== null) part("number").value = lab.number;
  }

  edited() {
    const { lab, part } = this;
    part("undo").disabled = !lab.past.length;
    part("redo").disabled = !lab.future.length;
    part("restore").disabled = !lab.past.length;
    if (document.activeElement !== part("text")) part("text").value = lab.text ?? "";
    this.#toAgent();
    this.#things();
    this.#goals();
    this.#unsplay();
    this.routed();
  }

  // Scroll the level as text to its agent.
  #toAgent() {
    const field = this.part("text");
    const [rows, above] = [field.value.split("\n"), field.value.split("@")[0].split("\n")];
    const [x, y] = [(above.at(-1).length + 0.5) / rows[0].length, (above.length - 0.5) / rows.length];
    field.scrollTo(x * field.scrollWidth - field.clientWidth / 2, y * field.scrollHeight - field.clientHeight / 2);
  }

  // The objects whose places may all be played, each that there are several of by its cell; and
  // what the page says first, about the first of them.
  #things() {
    const { lab, part } = this;
    const [found, kinds] = [[], []];
    for (const name of this.#objects()) {
      const cells = cellsOf(lab.level.grid, lab.rules.legend[lab.rules.objects[name]]);
      if (cells.length) kinds.push(`${cells.length > 1 ? "any" : "the"} ${named(lab, name)}`);
      for (const cell of cells.slice(0, 12)) {
        found.push([`${name}@${cell}`, named(lab, name) + (cells.length > 1 ? ` at (${cell.join(", ")})` : "")]);
      }
    }
    options(part("thing"), [...found, ["agent", "agent (where it begins)"]], part("thing").value);
    const picture = lab.episode.states[0].picture ?? "agent";
    const doer = lab.look.agent ?? picture.split("-")[0]; // of "robot-shards" the first
    const [thing = `the ${doer}`] = kinds;
    const why = ["agent", "variant", "level"].every((key) => (key === "level" ? lab.number : lab[key]) === lab.about.start[key]);
    part("lead").textContent = lab.agent
      ? `Drag ${thing}. The arrows are what the ${doer} would do. ${lab.about.agents[lab.agent].caveat ?? ""} ${(why && lab.about.start.why) || ""}`
      : `Drag ${thing}, or play.`;
  }

  // The goals that the level has, one of each event: first those that are compared.
  #goals() {
    const { lab, part, shift } = this;
    const { look, rules: { goals: events }, episode: { states: [s] } } = lab;
    const found = {}; // by event
    for (const goal of [shift?.intended, ...(shift?.proxies ?? []), ...Object.keys(events)]) {
      if (goal in events && (look.holds?.(events[goal], s) ?? true)) found[events[goal]] ??= goal;
    }
    options(part("goal"), Object.values(found).map((goal) => [goal, goal]), part("goal").value);
  }

  problem(text) {
    const line = this.part("problem");
    line.hidden = !text;
    line.textContent = text ?? "";
  }

  // Description of the cell under the pointer.
  readout(cell) {
    const { lab } = this;
    const line = this.part("readout");
    const found = cell && lab.fields.get(String(cell));
    if (!found) {
      const what = cell && lab.editor.what(cell); // at the beginning: later it may be elsewhere
      line.textContent = cell ? `(${cell.join(", ")}) ${lab.now && what !== "wall" ? "" : what}` : "";
      return;
    }
    const ways = lab.rules.actions.map((name) => lab.look.direction(name));
    const rates = Object.entries(rateOfWays(found.policy, ways)).sort((a, b) => b[1] - a[1]);
    const told = rates.filter(([, rate]) => rate >= 0.01).slice(0, 4)
      .map(([way, rate]) => `${NAMES[way]} ${percent(rate)}`);
    const value = found.value === null ? "no value" : `value ${rounded(found.value)}`;
    line.textContent = `(${cell.join(", ")}) ${value}; ${told.join(", ")}`;
  }

  legend({ heat: layer }) {
    const box = this.part("legend");
    box.hidden = !layer;
    if (!layer) return;
    const stops = Array.from({ length: 9 }, (_, k) => (layer.signed ? signed(k / 4 - 1) : heat(k / 8)));
    const style = `background: linear-gradient(to right, ${stops.join(", ")})`;
    const ramp = made("span", { className: "ramp", style });
    const told = (amount) => (layer.percent ? percent(amount) : rounded(amount));
    box.replaceChildren(`${layer.name}: ${told(layer.low)}`, ramp, told(layer.high));
  }

  compared() {
    const { lab, part } = this;
    const line = part("comparison");
    const both = [...lab.fields.values()].filter(({ cell, same }) => same && lab.others.get(String(cell))?.same);
    if (!part("compare").value || !both.length) {
      line.textContent = "";
      return;
    }
    const ways = lab.rules.actions.map((name) => lab.look.direction(name));
    const pairs = both.map((one) => [one, lab.others.get(String(one.cell))]);
    const varied = pairs.map(([a, b]) => variation(a, b));
    const turned = pairs.filter(([a, b]) => {
      const [one, two] = [meanWay(a.policy, ways), meanWay(b.policy, ways)];
      return one[0] * two[0] + one[1] * two[1] < 0;
    }).length;
    const mean = varied.reduce((a, b) => a + b, 0) / varied.length;
    const { caveat = "" } = lab.about.agents[part("compare").value.replace("agent ", "")] ?? {};
    line.textContent = `Red: what it is compared with. ${caveat && `${caveat} `}Policies differ by ${percent(mean)} on average ` +
      `(total variation; actions that do the same are one), and point against each other at ${turned} of ${both.length} places.`;
  }

  played() {
    const { lab, part } = this;
    if (!lab.episode) return;
    const { episode, now, agent, running, broken } = lab;
    const last = episode.actions.length;
    part("scrub").max = last;
    part("scrub").value = now;
    part("scrub").disabled = !last;
    part("rewind").disabled = part("back").disabled = now === 0;
    part("forth").disabled = now === last;
    const over = episode.ended && now === last;
    part("hand").disabled = !agent || broken || (over && !running);
    part("once").disabled = !agent || broken || over;
    part("hand").textContent = running ? "Stop" : "Hand over to the agent";
    const total = episode.rewards.slice(0, now).reduce((a, b) => a + b, 0);
    const end = over ? (episode.terminated ? "; the episode has ended" : "; the time was up") : "";
    part("account").textContent = last || now
      ? `Step ${now} of ${last}, return ${round(total)}${end}.${this.#hands()}`
      : `Nothing has moved yet: play${agent && ", or hand over"}.${this.#hands()}`;
    showTimeline(lab);
  }

  #hands() {
    const { taken, keys, opened, chests } = this.lab.stage.state ?? {};
    if ([taken, keys, opened, chests].includes(undefined)) return "";
    return ` In hand: ${taken - opened}; keys taken ${taken} of ${keys}, chests opened ${opened} of ${chests}.`;
  }

  // The badge of a level: whether it distinguishes the goals; null where nobody says so.
  distinguishes(does) {
    const badge = this.part("badge");
    badge.hidden = does === null || does === undefined || !this.shift;
    if (badge.hidden) return;
    const goals = [this.shift.intended, ...this.shift.proxies].join(" and ");
    badge.classList.toggle("not", !does);
    badge.textContent = does ? "distinguishes the goals" : "does not distinguish the goals";
    badge.title = does
      ? `In this level, the ways to ${goals} part: what it reaches first says which it pursues.`
      : `In this level, the way to one of ${goals} passes the other: what it reaches first says little.`;
  }

  // Three sentences for who comes for the first time; never again where they were skipped or read.
  tour() {
    const { lab, part } = this;
    const box = part("tour");
    const told = [
      "1 of 3. Training can teach another goal than the intended one. Drag something: do the arrows follow it?",
      "2 of 3. Hand over to the agent, and see which goal it reaches first.",
      "3 of 3. “Wherever it lies” plays an episode for every place. The panels look inside the agent.",
    ];
    const seen = () => { try { return localStorage.getItem("astray-tour"); } catch { return "unknown"; } };
    if (!lab.links || !lab.agent || lab.root.classList.contains("embedded") || seen()) return;
    const show = (step) => {
      box.hidden = step >= told.length;
      part("told").textContent = told[step] ?? "";
      part("on").textContent = step === told.length - 1 ? "Done" : "Next";
      part("on").onclick = () => show(step + 1);
      if (box.hidden) localStorage.setItem("astray-tour", "seen");
    };
    part("skip").addEventListener("click", () => show(told.length));
    show(0);
  }

  pursued() {
    const { lab, part } = this;
    const canvas = part("posterior");
    const found = lab.goals;
    canvas.hidden = !found;
    part("key").replaceChildren();
    if (!found || !lab.agent) {
      part("verdict").textContent = lab.goalless ?? (lab.rules?.real_time
        ? "Not known in this game: the agent does not move from cell to cell, as the measure needs."
        : "It shows as the agent walks: hand over to it, or walk yourself.");
      return;
    }
    const now = Math.min(lab.now, Object.values(found.goals)[0].length - 1);
    const colours = goalColours(this.shift, Object.keys(found.goals));
    drawPosterior(canvas, found, colours, now);
    const told = Object.entries(found.goals).map(([name, row]) => `${name} ${percent(row[now])}`);
    const many = found.goals[words.OTHER]?.[now] > 0.5 ? " One way fits many cells: compare the goals that have names." : "";
    const agent = found.agent ? ` The probability that it pursues any goal is ${percent(found.agent[now])}.` : "";
    part("verdict").textContent = `After ${counted(now, "step")}, if it pursues a goal: ${told.join(", ")}.${many}${agent}`;
    const names = Object.keys(found.goals).map((name) => [colours[name], named(lab, name)]);
    part("key").replaceChildren(...names.map(([colour, name]) => keyed(colour, name)),
      ...(found.agent ? [keyed(null, "an agent at all")] : []));
  }

  splayed(of) {
    const { lab, part } = this;
    const [counts, places] = [{}, lab.splay.size];
    for (const { outcomes } of lab.splay.values()) {
      for (const [goal, count] of Object.entries(outcomes)) counts[goal] = (counts[goal] ?? 0) + count;
    }
    const total = Object.values(counts).reduce((a, b) => a + b, 0);
    const colours = goalColours(this.shift);
    const draws = total === places ? "" : `, ${total} episodes`;
    const pursued = [this.shift?.intended, ...(this.shift?.proxies ?? [])];
    const early = (goal) => goal in lab.rules.goals; // others are known at the end
    const told = `${places} of ${counted(of, "place")}${draws}. A mark shows ${pursued.every(early) ? "where it goes first" : "how it ends"}.`;
    const line = made("p", { className: "soft", textContent: told });
    const order = [...pursued, words.NEITHER].filter((g) => g in counts);
    part("counts").replaceChildren(line, ...order.map((goal) =>
      bar(goal === words.NEITHER ? `✕ ${goal}`
        : `${goal === this.shift?.intended ? "●" : "◆"} ${early(goal) ? "first to the" : "ends with"} ${named(lab, goal)}`, counts[goal], total, colours[goal])));
    part("unsplay").hidden = false;
  }

  #unsplay() {
    const { lab, part } = this;
    lab.splay.clear();
    lab.splaying = null;
    part("counts").replaceChildren();
    part("unsplay").hidden = true;
    lab.stage.redraw();
  }

  routed() {
    const { lab, part } = this;
    const { way } = lab;
    part("unroute").hidden = !way;
    part("taking").textContent = !way ? "" : way.takes
      ? `It takes what is at (${way.takes[0].slice(0, 2).join(", ")}) first, after ${counted(way.steps, "step")}.`
      : `${counted(way.cells.length - 1, "step")}; it takes nothing.`;
  }

  unread() {
    this.part("readings").hidden = true;
  }

  // The labels that probes read from the state, beside the true ones.
  read({ rows, states }) {
    const table = this.part("readings");
    table.hidden = false;
    fillTable(table, ["label", "read", "true", "score in other states"], rows.map((row) =>
      [row.label, row["read as"], row["true as"], rounded(row.score)]));
    table.title = `Probes fitted in ${states} states of its own episodes.`;
  }

  // Show the agent's observation if its panel is open.
  async look() {
    const { lab, part } = this;
    if (!part("sight").open || !lab.agent || lab.broken) return;
    const question = { actions: lab.actions };
    const method = part("method").value;
    try {
      const seen = await lab.engine.ask(lab.question("view", question));
      const found = method && await lab.engine.ask(lab.question("attribution", { ...question, method }));
      if (seen) part("seen").textContent = drawSight(part("view"), seen, found?.map);
    } catch (error) {
      part("seen").textContent = error.message;
    }
  }
}
