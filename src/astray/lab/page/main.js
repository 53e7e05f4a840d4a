// Begins the page: finds out how to reach an agent, and shows the lab.

import { Lab } from "./app.js";
import { LocalEngine } from "./engine/local.js";
import { SocketEngine } from "./engine/socket.js";

function engineOf({ engine }) {
  if (engine === "static") return new LocalEngine(new URL(".", location.href));
  const { host, pathname, protocol } = location;
  const secure = protocol === "https:" ? "wss:" : "ws:";
  return new SocketEngine(`${secure}//${host}${pathname.replace(/[^/]*$/, "")}socket`);
}

const root = document.getElementById("lab");
if (new URLSearchParams(location.search).has("embedded")) root.classList.add("embedded");
globalThis.lab = new Lab(root, engineOf(document.body.dataset));
globalThis.lab.begin();
