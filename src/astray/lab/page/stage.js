// The world on its canvas, and the answers of the agent on top.

import { drawArrows, drawBars, drawDifference, drawHeat, drawRoute, drawSplay, ring } from "./draw/arrows.js";
import { goalColours, heat, themed } from "./draw/colours.js";
import { Brush } from "./games/common.js";

const TALLEST = 0.66; // of the window's height
const MARGINS = 26; // pixels above, between and below a small lab's board and buttons
const CLOSE = [19, 13]; // cells of a close-up
const ARROW = "#1d2b36";
const OTHER = "#b5446e"; // arrows of what is compared with
const EDGE = "rgba(255, 255, 255, 0.85)";

export class Stage {
  constructor(lab) {
    this.lab = lab;
    this.canvas = lab.part("world");
    this.waiting = false;
    this.layers = {};
    new ResizeObserver(() => this.redraw()).observe(lab.part("board").parentElement);
  }

  // Draw anew before the next picture of the screen, however often this is called.
  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      const { level, game } = this.lab;
      if (level && level.game === game) this.#draw(); // else one of another game is to come
    });
  }

  get state() {
    const { episode, now } = this.lab;
    return episode.states[Math.min(now, episode.states.length - 1)];
  }

  // The part of the world that is shown: its lower left cell, its columns and rows.
  get frame() {
    const { level, look, part } = this.lab;
    const [columns, rows] = look.wide?.(level, this.state) ?? [level.grid[0].length, level.grid.length];
    if (!look.view || !part("zoom").checked) return { left: 0, low: 0, columns, rows };
    const [wide, high] = [Math.min(CLOSE[0], columns), Math.min(CLOSE[1], rows)];
    const { x, y } = this.state;
    const between = (at, most) => Math.min(Math.max(at, 0), most);
    return {
      left: between(x - wide / 2, columns - wide), low: between(y - high / 2, rows - high),
      columns: wide, rows: high,
    };
  }

  #fit() {
    const { left, low, columns, rows } = this.frame;
    const room = this.lab.part("board").parentElement.clientWidth;
    const tall = Math.max(260, this.lab.root.classList.contains("small")
      ? globalThis.innerHeight - this.lab.root.querySelector(".player").offsetHeight - MARGINS
      : TALLEST * globalThis.innerHeight);
    const cell = Math.max(5, Math.min(room / columns, tall / rows));
    const ratio = globalThis.devicePixelRatio || 1;
    const [width, height] = [Math.floor(cell * columns), Math.floor(cell * rows)];
    const [fine, deep] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== fine || this.canvas.height !== deep) {
      [this.canvas.width, this.canvas.height] = [fine, deep];
      Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    }
    this.scale = cell * ratio;
    this.cell = cell;
    return { left, low, columns, rows };
  }

  #draw() {
    const { lab } = this;
    const { left, low, rows } = this.#fit();
    this.layers = {};
    const paint = this.canvas.getContext("2d");
    paint.setTransform(1, 0, 0, 1, 0, 0);
    paint.clearRect(0, 0, this.canvas.width, this.canvas.height);
    paint.setTransform(1, 0, 0, 1, -Math.round(left * this.scale), Math.round(low * this.scale));
    const brush = new Brush(paint, this.scale, rows);
    this.paintWorld(paint, this.scale, rows, this.state, () => {
      this.#agent(brush);
      this.#rings(brush);
      if (!lab.broken && lab.now > 0 && !lab.rules.real_time) this.#trail(brush);
      if (!lab.broken && lab.way) drawRoute(brush, lab.way, "#2e6db4", EDGE);
    });
    this.#marks(brush);
    lab.panels.legend(this.layers);
  }

  // The world, in so many pixels a cell; top: its height in cells; below: draws what lies below
  // agent and objects.
  paintWorld(paint, scale, top, state = this.state, below = () => {}) {
    const { lab } = this;
    const brush = new Brush(paint, scale, top);
    const pictures = lab.pictures[lab.game];
    if (!pictures) return;
    lab.look.still(brush, lab.level, state, pictures, lab.rules);
    this.#heat(brush);
    below();
    if (lab.broken) this.#things(brush);
    else lab.look.moving(brush, lab.level, state, pictures, lab.rules);
  }

  // A level that cannot begin has no state: its objects are drawn from its cells.
  #things(brush) {
    const { lab } = this;
    const names = Object.fromEntries(
      Object.entries(lab.rules.objects).map(([name, char]) => [lab.rules.legend[char], name]));
    const letter = (text, x, y) => brush.letter(text, x + 0.5, y + 0.5, "#a8480a", "700 1em system-ui");
    lab.level.grid.forEach((row, y) => row.forEach((what, x) => {
      if (what in names) letter(names[what][0], x, y);
    }));
    letter("@", ...lab.level.agent.map(Math.floor));
  }

  #heat(brush) {
    const { lab } = this;
    const layer = lab.splay.size ? "none" : lab.part("heat").value;
    if (layer === "goals" && lab.goals) {
      const { cells, rates } = lab.goals;
      const row = rates[Math.min(lab.now, rates.length - 1)];
      const most = Math.max(...row);
      cells.forEach((cell, k) => brush.fill(heat(row[k] / most, 0.9), ...cell));
      this.layers.heat = { name: "likelihood of its goal", low: 0, high: most, percent: true };
      return;
    }
    const { fields, others } = lab;
    if (!fields.size || (layer !== "value" && layer !== "sure")) return;
    const all = [...fields.values(), ...others.values()];
    if (layer === "value" && all.some(({ value }) => value === null)) return; // of a policy without values
    const number = layer === "value" ? (one) => one.value : (one) => Math.max(...one.policy);
    const name = layer === "value" ? "value" : "probability of its likeliest action";
    if (others.size) {
      const both = new Map([...fields].filter(([key]) => others.has(key)));
      const change = (one) => number(one) - number(others.get(String(one.cell)));
      this.layers.heat = { name: `difference of ${name}`, signed: true, ...drawDifference(brush, both, change) };
    } else {
      this.layers.heat = { name, ...drawHeat(brush, fields, number) };
    }
  }

  #agent(brush) {
    const { lab } = this;
    const layer = lab.part("layer").value;
    const ways = lab.rules.actions.map((name) => lab.look.direction(name));
    const draw = { arrows: drawArrows, bars: drawBars }[layer];
    if (lab.splay.size) {
      drawSplay(brush, lab.splay, goalColours(lab.panels.shift), EDGE, lab.panels.shift?.intended);
      return;
    }
    if (!draw || lab.broken) return;
    if (lab.others.size) draw(brush, lab.others, ways, OTHER, EDGE);
    draw(brush, lab.fields, ways, ARROW, EDGE);
  }

  #marks(brush) {
    const { lab } = this;
    const ink = themed(this.canvas, "--held");
    const { view } = lab.look;
    if (view && !lab.broken && !lab.part("zoom").checked) {
      const { x, y } = this.state;
      brush.square(x - view / 2, y - view / 2, view);
      for (const [style, width] of [["rgba(255,255,255,.8)", 4], [ink, 2]]) brush.stroke(style, 0, width);
    }
    const { cursor } = lab.editor;
    if (cursor) {
      brush.square(...cursor, 1);
      brush.stroke(ink, 0.08, 2);
    }
  }

  // Where proxies are, below agent and objects.
  #rings(brush) {
    const { lab } = this;
    if (lab.broken) return;
    const colours = goalColours(lab.panels.shift, Object.keys(lab.rules.goals));
    for (const [goal, cell] of Object.entries(lab.look.proxies(this.state))) {
      ring(brush, ...cell, colours[goal] ?? "#f0a03c", EDGE);
    }
  }

  // Where the episode has been.
  #trail(brush) {
    const shown = this.lab.episode.states.slice(0, this.lab.now + 1);
    brush.path(shown.map(({ agent, x, y }) => agent ?? [x, y]));
    brush.stroke("rgba(255, 255, 255, 0.5)", 0.1, 1.5, [0.16, 0.12]);
    brush.stroke("rgba(30, 30, 30, 0.5)", 0.06, 1.5, [0.16, 0.12]);
  }

  // The cell under a pointer; null outside.
  cellAt({ clientX, clientY }) {
    const box = this.canvas.getBoundingClientRect();
    const { left, low, rows } = this.frame;
    const x = Math.floor(left + (clientX - box.left) / this.cell);
    const y = Math.floor(low + rows - (clientY - box.top) / this.cell);
    return this.lab.level?.grid[y]?.[x] === undefined ? null : [x, y];
  }
}
