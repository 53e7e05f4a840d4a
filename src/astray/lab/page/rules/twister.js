// The Mersenne Twister that decides ties, as `astray.kernel.rng` draws from it.

import { twister } from "./constants.js";

const { WORDS, MIDDLE, SEED_FACTOR, TWIST, HIGH_BIT, LOW_31, TEMPER_B, TEMPER_C } = twister;

export class Twister {
  constructor(number) {
    this.words = new Uint32Array(WORDS);
    this.next = 0;
    let word = number >>> 0;
    this.words[0] = word;
    for (let i = 1; i < WORDS; i++) {
      word = (Math.imul(SEED_FACTOR, word ^ (word >>> 30)) + i) >>> 0;
      this.words[i] = word;
    }
  }

  copy() {
    const copy = Object.create(Twister.prototype);
    copy.words = this.words.slice();
    copy.next = this.next;
    return copy;
  }

  word() {
    const { words, next: i } = this;
    const after = (i + 1) % WORDS;
    const y = (words[i] & HIGH_BIT) | (words[after] & LOW_31);
    let word = words[(i + MIDDLE) % WORDS] ^ (y >>> 1);
    if (y & 1) word ^= TWIST;
    words[i] = word;
    this.next = after;
    word = words[i];
    word ^= word >>> 11;
    word ^= (word << 7) & TEMPER_B;
    word ^= (word << 15) & TEMPER_C;
    return (word ^ (word >>> 18)) >>> 0;
  }

  below(n) {
    return this.word() % n;
  }

  unit() {
    return Math.fround(this.word() / 4294967296);
  }
}
