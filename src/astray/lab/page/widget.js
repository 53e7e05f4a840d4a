// The lab in a notebook: its modules come over the notebook's channel, and nothing is fetched.

// Addresses of modules, made of their texts; those that they import are made before them.
function addresses(modules) {
  const known = new Map();
  const addressOf = (path) => {
    if (!known.has(path)) {
      const text = modules[path].replace(/from "(\.[^"]+)"/g, (_, to) => {
        const { pathname } = new URL(to, `http://lab/${path}`);
        return `from "${addressOf(pathname.slice(1))}"`;
      });
      known.set(path, URL.createObjectURL(new Blob([text], { type: "text/javascript" })));
    }
    return known.get(path);
  };
  return addressOf;
}

// Asks the notebook's kernel, as `engine/socket.js` asks a server.
class KernelEngine {
  constructor(model) {
    this.model = model;
    this.waiting = new Map();
    this.next = 1;
    this.status = () => {};
    model.on("msg:custom", (content) => this.hear(content));
  }

  hear({ id, done, error, ...part }) {
    const asked = this.waiting.get(id);
    if (!asked) return;
    if (!done) {
      asked.heard(part);
      return;
    }
    this.waiting.delete(id);
    if (error) asked.reject(new Error(error));
    else asked.resolve(part);
  }

  ask(message, heard = () => {}) {
    const id = this.next++;
    const same = ({ kind, slot = "" }) => `${kind} ${slot}`;
    for (const [other, asked] of this.waiting) {
      if (same(asked.message) !== same(message)) continue;
      this.waiting.delete(other);
      asked.resolve(null);
    }
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject, heard, message });
      this.model.send(JSON.stringify({ id, ...message }));
    });
  }
}

async function render({ model, el }) {
  const modules = model.get("modules");
  const { Lab } = await import(addresses(modules)("app.js"));
  const page = new DOMParser().parseFromString(modules["index.html"], "text/html");
  const root = document.importNode(page.getElementById("lab"), true);
  root.classList.add("embedded");
  el.append(root);
  const lab = new Lab(root, new KernelEngine(model), { links: false });
  el.lab = lab;
  await lab.begin();
}

export default { render };
