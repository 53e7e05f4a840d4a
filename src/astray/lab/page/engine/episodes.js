// Episodes as `astray.lab.worlds` plays and tells them.

import { advance } from "../rules/common.js";

export function played({ s, rules }, actions) {
  const episode = { states: [rules.copy(s)], actions: [], rewards: [], terminated: false, ended: false };
  for (const action of actions) take(episode, rules, action);
  return episode;
}

export function take(episode, rules, action) {
  if (episode.ended) throw new Error(`the episode has ended after ${episode.actions.length} steps`);
  const s = rules.copy(episode.states.at(-1));
  const { reward, terminated } = advance(rules, s, action);
  episode.states.push(s);
  episode.actions.push(action);
  episode.rewards.push(reward);
  Object.assign(episode, { terminated, ended: s.ended });
}

// For each action the first one with the same next state, number of draws included.
export function effects(rules, s, count) {
  const seen = new Map();
  return Array.from({ length: count }, (_, action) => {
    const after = rules.copy(s);
    advance(rules, after, action);
    const changed = Object.entries(after).filter(([name, what]) => what !== s[name] && name !== "mt");
    const key = JSON.stringify(changed, (_, x) => (typeof x === "bigint" ? `${x}` : x));
    if (!seen.has(key)) seen.set(key, action);
    return seen.get(key);
  });
}

export function told(episode, first, agent, rules) {
  const states = episode.states.slice(first);
  return {
    first, states: states.map((s) => snapshot(s, rules)), actions: episode.actions.slice(Math.max(first - 1, 0)),
    rewards: episode.rewards.slice(Math.max(first - 1, 0)), terminated: episode.terminated,
    ended: episode.ended,
    ...(agent && { value: states.map((s) => agent.policyAndValue(s, rules).value) }),
  };
}

// The fields of a state that a page shows.
export function snapshot(s, rules) {
  const shown = Object.fromEntries(rules.shown.map((name) => [name, s[name]]));
  return structuredClone({ ...shown, ...rules.view?.(s) });
}
