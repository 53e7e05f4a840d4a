// Questions that are asked elsewhere, and their answers as they come.

import { messages } from "../rules/constants.js";

export class Questions {
  // `send` sends the text of a question, which says its id; its answers are for `hear`.
  constructor(send) {
    this.send = send;
    this.waiting = new Map();
    // A notebook's kernel answers all cells that show a widget; none takes another's answers.
    this.next = 1 + Math.floor(Math.random() * 2 ** 50);
  }

  hear({ id, done, stale, error, ...part }) {
    const asked = this.waiting.get(id);
    if (!asked) return;
    if (done) this.waiting.delete(id);
    if (!done) asked.heard(part);
    else if (stale) asked.resolve(null);
    else if (error) asked.reject(new Error(error));
    else asked.resolve(part);
  }

  // The last part of the answer; `heard` gets those before it. null where a newer question came.
  ask(message, heard = () => {}) {
    const id = this.next++;
    const text = JSON.stringify({ id, ...message });
    this.#giveUp(message);
    return new Promise((resolve, reject) => {
      const most = messages.LARGEST; // of more, the connection would be cut, and it asked again
      if (text.length > most) throw new Error(`a message must be at most ${most} characters; got ${text.length}`);
      this.waiting.set(id, { resolve, reject, heard, text, message });
      this.send(text);
    });
  }

  // Sends all that was not answered once more.
  sendAgain() {
    for (const { text } of this.waiting.values()) this.send(text);
  }

  // Questions that a newer one takes the place of are not asked again.
  #giveUp({ kind, slot = "" }) {
    for (const [id, asked] of this.waiting) {
      if (asked.message.kind === kind && (asked.message.slot ?? "") === slot) {
        this.waiting.delete(id);
        asked.resolve(null);
      }
    }
  }
}
