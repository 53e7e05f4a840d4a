// Asks a page's questions of the Python process that served it, over a WebSocket.
//
// If the connection is lost, the page says so, and it is tried again; questions that were not
// answered are asked again. The server keeps nothing that a question does not bring with it.

const FIRST_WAIT = 400; // milliseconds
const LONGEST_WAIT = 5000;

export class SocketEngine {
  constructor(address) {
    this.address = address;
    this.waiting = new Map();
    this.next = 1;
    this.wait = FIRST_WAIT;
    this.status = () => {};
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(this.address);
    this.socket.onopen = () => {
      this.wait = FIRST_WAIT;
      this.status("connected");
      for (const { text } of this.waiting.values()) this.socket.send(text);
    };
    this.socket.onmessage = ({ data }) => this.hear(JSON.parse(data));
    this.socket.onclose = () => {
      this.status("lost");
      setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    };
  }

  hear({ id, done, stale, error, ...part }) {
    const asked = this.waiting.get(id);
    if (!asked) return;
    if (!done) {
      asked.heard(part);
      return;
    }
    this.waiting.delete(id);
    if (stale) asked.resolve(null);
    else if (error) asked.reject(new Error(error));
    else asked.resolve(part);
  }

  // The last part of the answer; `heard` gets those before it. null where a newer question came.
  ask(message, heard = () => {}) {
    const id = this.next++;
    const text = JSON.stringify({ id, ...message });
    this.#giveUp(message);
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject, heard, text, message });
      if (this.socket.readyState === WebSocket.OPEN) this.socket.send(text);
    });
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
