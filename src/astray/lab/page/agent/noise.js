// Uniform numbers that are functions of seed, level and step: `astray.kernel.rng.fill_noise`.

import { noises } from "../rules/constants.js";

const MASK = (1n << 64n) - 1n;
const { TO_UNIT, BELOW_ONE } = noises;
const [GAMMA, MIX_1, MIX_2] = [noises.GAMMA, noises.MIX_1, noises.MIX_2].map(BigInt);
const TINY = 1.1754943508222875e-38; // the smallest normal number of 32 bits

function mix(number) {
  let z = number ^ GAMMA;
  z = ((z ^ (z >> 30n)) * MIX_1) & MASK;
  z = ((z ^ (z >> 27n)) * MIX_2) & MASK;
  return z ^ (z >> 31n);
}

export const mixTwo = (number, salt) => mix(mix(number) ^ salt);

// [count] numbers from 0 to 1 for the next action in a level at a step.
export function noise(seed, level, time, count) {
  const episode = mixTwo(BigInt(seed), BigInt.asUintN(64, BigInt(level)));
  return Array.from({ length: count }, (_, k) =>
    Math.fround(Number(mixTwo(episode, BigInt(time * count + k)) >> 11n) * TO_UNIT));
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
