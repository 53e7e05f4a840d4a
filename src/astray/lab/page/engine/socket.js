// Asks a page's questions of the Python process that served it, over a WebSocket.
//
// If the connection is lost, the page says so, and it is tried again; questions that were not
// answered are asked again. The server keeps nothing that a question does not bring with it.

import { Questions } from "./questions.js";

const FIRST_WAIT = 400; // milliseconds
const LONGEST_WAIT = 5000;

export class SocketEngine {
  constructor(address) {
    this.address = address;
    this.questions = new Questions((text) => {
      if (this.socket.readyState === WebSocket.OPEN) this.socket.send(text);
    });
    this.wait = FIRST_WAIT;
    this.status = () => {};
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(this.address);
    this.socket.onopen = () => {
      this.wait = FIRST_WAIT;
      this.status("connected");
      this.questions.sendAgain();
    };
    this.socket.onmessage = ({ data }) => this.questions.hear(JSON.parse(data));
    this.socket.onclose = () => {
      this.status("lost");
      setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    };
  }

  ask(message, heard) {
    return this.questions.ask(message, heard);
  }
}
