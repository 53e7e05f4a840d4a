// Tables of the outputs of agents that are too large to be computed here.
//
// For some levels, and in them for every place of the goal and of the agent, facing left or right,
// its policy and value were computed beforehand, a byte for each probability. A level is known by
// what else images show, its walls, its looks and its other object: one that was edited has no number.

import { NEVER, WALL, world } from "../rules/common.js";

// file: fetches by path; about: {path, bytes}, of an index and of what it points into.
export async function readTable(file, about) {
  const index = await file(about.path);
  const bytes = new Uint8Array(await file(about.bytes, "bytes"));
  const { actions, low, high, seen, one: most } = index; // most: the byte of a probability of 1
  const key = (walls, looks, other) => [walls, ...looks, other].join(" ");
  const levels = new Map(index.levels.map(({ walls, looks, other, ...level }) => [key(walls, looks, other), level]));
  return (s) => {
    const walls = world(s, s.cell).map((row) => row.map((what) => (what === WALL ? "#" : ".")).join(""));
    const other = s.other_x === NEVER ? "" : `${s.other_x},${s.other_y}`;
    const level = levels.get(key(walls.join("\n"), seen.map((name) => s[name]), other));
    if (!level) {
      throw new Error("this agent's answers were computed beforehand, for levels as they are " +
        "numbered: it and its goal may be moved here, but nothing else; with Python all may: " +
        "astray lab");
    }
    const gone = s.goal_x === NEVER || s.reached_goal !== NEVER;
    const goal = gone ? "none" : `${s.goal_x},${s.goal_y}`;
    const rows = level.goals[goal];
    const row = level.places.indexOf(`${Math.floor(s.x)},${Math.floor(s.y)}`);
    if (rows === undefined || row < 0) {
      throw new Error("this agent's answers were computed beforehand, but not of this place");
    }
    const at = (rows + row + (s.faces_right ? level.places.length : 0)) * (actions + 1);
    const policy = Array.from(bytes.subarray(at, at + actions), (byte) => byte / most);
    const sum = policy.reduce((a, b) => a + b, 0) || 1;
    const value = low + ((high - low) * bytes[at + actions]) / most;
    return { policy: policy.map((rate) => rate / sum), value };
  };
}
