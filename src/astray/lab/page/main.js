// Begins the page: finds out how to reach an agent, and shows the lab.

import { Lab } from "./app.js";
import { SocketEngine } from "./engine/socket.js";

async function engineOf({ engine }) {
  if (engine === "static") { // which alone needs compiled rules
    const { LocalEngine } = await import("./engine/local.js");
    return new LocalEngine(new URL(".", location.href));
  }
  const { host, pathname, protocol } = location;
  const secure = protocol === "https:" ? "wss:" : "ws:";
  return new SocketEngine(`${secure}//${host}${pathname.replace(/[^/]*$/, "")}socket`);
}

const root = document.getElementById("lab");
const embedded = new URLSearchParams(location.search).get("embedded");
if (embedded !== null) root.classList.add("embedded", ...(embedded ? [embedded] : [])); // "small": the board
globalThis.lab = new Lab(root, await engineOf(document.body.dataset));
globalThis.lab.begin();
