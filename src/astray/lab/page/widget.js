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

// An engine that asks the notebook's kernel, as `engine/socket.js` asks a server.
function kernelEngine(model, Questions, signal) {
  const questions = new Questions((text) => model.send(text));
  const hear = (content) => questions.hear(content);
  model.on("msg:custom", hear);
  signal.addEventListener("abort", () => model.off("msg:custom", hear));
  return { status: () => {}, ask: (message, heard) => questions.ask(message, heard) };
}

async function render({ model, el }) {
  const modules = model.get("modules");
  const addressOf = addresses(modules);
  const { Lab } = await import(addressOf("app.js"));
  const { Questions } = await import(addressOf("engine/questions.js"));
  const page = new DOMParser().parseFromString(modules["index.html"], "text/html");
  const root = document.importNode(page.getElementById("lab"), true);
  root.classList.add("embedded");
  el.append(root);
  const ending = new AbortController();
  const { signal } = ending;
  const lab = new Lab(root, kernelEngine(model, Questions, signal), { links: false, signal });
  el.lab = lab;
  // JupyterLab hears keys that no field takes: after a click on a button, "d d" deletes the cell.
  root.addEventListener("keydown", (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.altKey) event.stopPropagation();
  });
  await lab.begin();
  return () => ending.abort(); // once the cell is cleared
}

export default { render };
