// Uniform numbers that are functions of seed, level and step: `astray.kernel.rng.fill_noise`.

import { noises } from "../rules/constants.js";
import { fraction, mix_two } from "../rules/kernels.js";

const { BELOW_ONE } = noises;
const TINY = 1.1754943508222875e-38; // the smallest normal number of 32 bits

// [count] numbers from 0 to 1 for the next action in a level at a step.
export function noise(seed, level, time, count) {
  const episode = mix_two(seed, level);
  return Array.from({ length: count }, (_, k) => Math.fround(fraction(episode, time * count + k)));
}

// An action drawn from probabilities by the Gumbel trick, as `astray.training.ppo.sample` does.
export function sample(policy, uniform) {
  let [best, most] = [0, -Infinity];
  policy.forEach((rate, action) => {
    const u = Math.min(Math.max(uniform[action], TINY), Math.fround(BELOW_ONE));
    const score = Math.log(rate) - Math.log(-Math.log(u));
    if (score > most) [best, most] = [action, score];
  });
  return best;
}
