// Changes to the level by pointer and keyboard, and playing by keys.

import { carried } from "./level.js";

const KEYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  a: [-1, 0], d: [1, 0], w: [0, 1], s: [0, -1],
};

const FIELDS = "select, textarea, input:not([type=checkbox])";

// The key of an event, the same with Shift or Caps Lock.
const keyOf = ({ key }) => (key.length === 1 ? key.toLowerCase() : key);

export class Editor {
  constructor(lab) {
    this.lab = lab;
    this.tool = "hand";
    this.cursor = null;
    this.held = null; // what is dragged: {name, code, from}
    this.pressed = new Set();
    const canvas = lab.part("world");
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", () => this.#drop());
    canvas.addEventListener("pointercancel", () => this.#drop());
    canvas.addEventListener("pointerleave", () => this.lab.panels.readout(null));
    const board = lab.part("board");
    // A page hears keys wherever they are pressed, but for those that fields take or that press
    // buttons; a notebook's cell hears its own.
    const ear = lab.links ? globalThis : lab.root;
    ear.addEventListener("keydown", (event) => {
      const presses = event.key === " " || event.key === "Enter";
      if (!event.target.closest?.(presses ? `${FIELDS}, input, button, summary, a` : FIELDS)) {
        this.#key(event);
      }
    });
    ear.addEventListener("keyup", (event) => this.pressed.delete(keyOf(event)));
    globalThis.addEventListener("blur", () => this.pressed.clear(), { signal: lab.signal });
    lab.part("cursor").addEventListener("change", ({ target }) => {
      this.cursor = target.checked ? lab.level.agent.map(Math.floor) : null;
      this.held = null;
      lab.stage.redraw();
      if (target.checked) board.focus();
    });
  }

  // The content of a cell: "agent", an object's name, "wall", or "" for nothing.
  what([x, y]) {
    const { level, rules } = this.lab;
    if (String(level.agent.map(Math.floor)) === String([x, y])) return "agent";
    const code = level.grid[y][x];
    const found = Object.entries(rules.objects).find(([, char]) => rules.legend[char] === code);
    if (found) return found[0];
    return code === rules.legend["."] ? "" : "wall";
  }

  #press(event) {
    const { lab } = this;
    const cell = lab.level && lab.stage.cellAt(event);
    if (!cell || !lab.rules.editing) return;
    lab.part("board").focus({ preventScroll: true });
    event.target.setPointerCapture?.(event.pointerId);
    if (this.tool === "hand") {
      this.#lift(cell);
    } else {
      this.#paint(cell, true);
      this.last = String(cell);
    }
  }

  #lift(cell) {
    const [x, y] = cell;
    const { now, stage } = this.lab;
    const shown = now && (stage.state.agent ?? [stage.state.x, stage.state.y]).map(Math.floor);
    const name = String(shown) === String(cell) ? "agent" : this.what(cell); // where it is by now
    if (!name || name === "wall") return;
    this.held = { name, code: this.lab.level.grid[y][x], at: cell, first: true };
    this.lab.part("world").classList.add("grabbing");
  }

  #move(event) {
    const { lab } = this;
    const cell = lab.level && lab.stage.cellAt(event);
    lab.panels.readout(cell);
    if (!cell) return;
    const name = this.what(cell);
    const canvas = lab.part("world");
    canvas.classList.toggle("grab", this.tool === "hand" && Boolean(name) && name !== "wall");
    canvas.classList.toggle("draw", this.tool !== "hand");
    if (this.held) this.#carry(cell);
    else if (this.last && this.last !== String(cell) && event.buttons) {
      this.#paint(cell, false);
      this.last = String(cell);
    }
  }

  // Put what is held into another cell, if that is empty.
  #carry(cell) {
    const { held } = this;
    if (String(cell) === String(held.at) || this.what(cell)) return;
    const level = this.#copy();
    const { legend } = this.lab.rules;
    if (held.name === "agent") {
      level.agent = [cell[0] + 0.5, cell[1] + 0.5];
    } else {
      level.grid[held.at[1]][held.at[0]] = legend["."];
      level.grid[cell[1]][cell[0]] = held.code;
      level.looks = carried(level.looks, held.at, cell);
    }
    this.held = { ...held, at: cell, first: false };
    this.lab.edit(level, held.first);
  }

  #drop() {
    this.held = this.last = null;
    this.lab.part("world").classList.remove("grabbing");
  }

  // Let go of what was held in another level, and keep the cursor within this one.
  leave() {
    const { grid, agent } = this.lab.level;
    const [x, y] = this.cursor ?? [0, 0];
    this.#drop();
    if (grid[y]?.[x] === undefined) this.cursor = agent.map(Math.floor);
  }

  // Draw or erase with the tool a wall or an object, as in the first cell of a stroke.
  #paint(cell, first) {
    const { legend, objects } = this.lab.rules;
    const there = this.what(cell);
    if (first) this.painting = there !== this.tool;
    if (there === "agent" || (this.painting ? there !== "" : there !== this.tool)) return;
    const level = this.#copy();
    const code = this.tool === "wall" ? legend["#"] ?? 1 : legend[objects[this.tool]];
    level.grid[cell[1]][cell[0]] = this.painting ? code : legend["."];
    level.looks = carried(level.looks, cell);
    this.lab.edit(level, first);
  }

  #copy() {
    const { grid, agent } = this.lab.level;
    return { ...this.lab.level, grid: grid.map((row) => [...row]), agent: [...agent] };
  }

  #key(event) {
    const { lab } = this;
    if (!lab.ready) return;
    const key = keyOf(event);
    if (event.ctrlKey || event.metaKey) {
      if (key === "z") this.#do(event, () => (event.shiftKey ? lab.redo() : lab.undo()));
      if (key === "y") this.#do(event, () => lab.redo());
      return;
    }
    if (event.altKey) return;
    const others = {
      Home: () => lab.go(0), ",": () => lab.go(lab.now - 1), ".": () => lab.go(lab.now + 1),
      n: () => lab.step(), h: () => lab.handOver(),
    };
    const further = lab.further[Number(key) - 1];
    if (further) this.#do(event, () => lab.act(further));
    else if (key in others) this.#do(event, others[key]);
    else if (this.cursor) this.#steer(event, key);
    else if (key in KEYS || key === " ") this.#do(event, () => this.#play(key, event.repeat));
  }

  #do(event, work) {
    event.preventDefault();
    work();
  }

  // Keys move the cursor; Enter and space do what a click would.
  #steer(event, key) {
    const { lab } = this;
    if (key in KEYS) {
      const cell = [this.cursor[0] + KEYS[key][0], this.cursor[1] + KEYS[key][1]];
      this.#do(event, () => {
        if (lab.level.grid[cell[1]]?.[cell[0]] === undefined) return;
        this.cursor = cell;
        if (this.held) this.#carry(cell);
        lab.panels.readout(cell);
        lab.stage.redraw();
      });
    } else if (key === "Enter" || key === " ") {
      this.#do(event, () => {
        if (this.held) this.#drop();
        else if (this.tool === "hand") this.#lift(this.cursor);
        else this.#paint(this.cursor, true);
      });
    } else if (key === "Escape") {
      this.#drop();
    }
  }

  // The action that all pressed keys mean together.
  async #play(key, repeats) {
    this.pressed.add(key);
    let [x, y] = [0, 0];
    for (const one of this.pressed) {
      x += KEYS[one]?.[0] ?? 0;
      y += KEYS[one]?.[1] ?? 0;
    }
    const words = [["left", "", "right"][Math.sign(x) + 1], ["down", "", "up"][Math.sign(y) + 1]];
    const name = words.filter(Boolean).join("-") || "stay";
    if (this.acting && repeats) return; // held down, it repeats faster than the world moves
    const mine = this.acting = Promise.resolve(this.acting).then(() => this.lab.act(name));
    await mine;
    if (this.acting === mine) this.acting = null;
  }
}
