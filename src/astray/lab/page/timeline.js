// The timeline of an episode: value, advantages, events.

import { advantages, divided, drawTimeline } from "./draw/charts.js";
import { made } from "./parts.js";

// The episode's curves, and buttons that go to its marked steps.
export function showTimeline(lab) {
  const { episode, now, part } = lab;
  const last = episode.actions.length;
  const canvas = part("timeline");
  canvas.hidden = !last || !lab.agent || episode.value.length < last + 1 || episode.value.includes(null);
  if (canvas.hidden) {
    part("bookmarks").replaceChildren();
    return;
  }
  const advantage = advantagesOf(lab);
  const final = episode.states.at(-1);
  const events = lab.rules.events.filter((name) => final[name] >= 0 && final[name] <= last)
    .map((name) => ({ name: name.replace(/_/g, " "), step: final[name] }))
    .sort((one, two) => one.step - two.step);
  drawTimeline(canvas, { value: episode.value, advantage, events, last }, now);
  // An agent may idle after the last event.
  const done = advantage.slice(0, Math.max(0, ...events.map(({ step }) => step)) || last);
  const best = done.indexOf(Math.max(...done));
  const worst = done.indexOf(Math.min(...done));
  bookmarks(lab, [["highest advantage", best], ["lowest advantage", worst],
    ...events.slice(0, 4).map(({ name, step }) => [name, step])]);
}

// The advantages of the episode's actions, in the rewards that the agent's values are of.
export function advantagesOf({ about, agent, episode }) {
  const { gamma, lam, reward_deviation: deviation } = about.agents[agent];
  const rewards = divided(episode.rewards, deviation);
  return advantages(episode.value, rewards, episode.terminated, gamma, lam);
}

function bookmarks(lab, marks) {
  const box = lab.part("bookmarks");
  const texts = marks.map(([name, step]) => `${name}: step ${step}`);
  if (texts.join() === [...box.children].map((one) => one.textContent).join()) return; // keeps the focus
  box.replaceChildren(...marks.map(([, step], k) => made("button", { onclick: () => lab.go(step) }, texts[k])));
}
