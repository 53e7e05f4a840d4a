// The Mersenne Twister that decides ties, as `astray.kernel.rng` draws from it.

import { twister } from "./constants.js";

const { WORDS, MIDDLE } = twister;

export class Twister {
  constructor(number) {
    this.words = new Uint32Array(WORDS);
    this.next = 0;
    let word = number >>> 0;
    this.words[0] = word;
    for (let i = 1; i < WORDS; i++) {
      word = (Math.imul(1812433253, word ^ (word >>> 30)) + i) >>> 0;
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
    const y = (words[i] & 0x80000000) | (words[after] & 0x7fffffff);
    let word = words[(i + MIDDLE) % WORDS] ^ (y >>> 1);
    if (y & 1) word ^= 0x9908b0df;
    words[i] = word;
    this.next = after;
    word = words[i];
    word ^= word >>> 11;
    word ^= (word << 7) & 0x9d2c5680;
    word ^= (word << 15) & 0xefc60000;
    return (word ^ (word >>> 18)) >>> 0;
  }

  below(n) {
    return this.word() % n;
  }

  unit() {
    return Math.fround(this.word() / 4294967296);
  }
}
