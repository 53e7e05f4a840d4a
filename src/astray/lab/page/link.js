// Addresses that hold a level and an agent: #game=…&variant=…&agent=…&level=17, or a drawn level.

import { plain } from "./level.js";
import { levels } from "./rules/constants.js";

const LONGEST = 50_000; // characters of a level in an address, which unpack to 39 MB at most

// Parse an address; `wrong` has the parts that this lab cannot show. No other agent is ever put
// in the place of one that is not here.
export async function fromLink(hash, about) {
  const words = new URLSearchParams(hash.slice(1));
  const game = words.get("game");
  if (!["game", "variant", "agent", "level", "drawn"].some((name) => words.has(name))) return {};
  if (!Object.hasOwn(about.games, game)) return { agent: "", wrong: `This lab has no game ${quoted(game ?? "")}.` };
  const wrong = [];
  let agent = agentOf(words.get("agent"), game, about, wrong);
  const { variants } = about.games[game];
  let variant = words.get("variant");
  if (!Object.hasOwn(variants, variant)) {
    if (variant !== null) wrong.push(`This lab has no variant ${quoted(variant)} of ${game}.`);
    variant = about.agents[agent]?.test ?? Object.keys(variants)[0];
  }
  if (agent && !about.agents[agent].variants.includes(variant)) {
    wrong.push(`The agent '${agent}' cannot play in ${variant} here; no agent is shown.`);
    agent = "";
  }
  const number = words.get("level") ?? "0";
  let level = Number(number);
  if (!(/^\d+$/.test(number) && level < levels.MOST)) {
    wrong.push(`A level must be a number from 0 to ${levels.MOST - 1}; the link has ${quoted(number)}.`);
    level = 0;
  }
  if (words.has("drawn")) {
    const drawn = await unpacked(words.get("drawn"));
    if (!drawn) wrong.push("The level that was drawn cannot be read from the link.");
    level = drawn ?? level;
  }
  return { game, variant, agent: agent ?? firstOf(about, game, variant), level, wrong: wrong.join(" ") };
}

// The agent of a link; "" where it is none of this game here, null where the link does not say.
function agentOf(name, game, { agents, broken }, wrong) {
  const agent = Object.hasOwn(agents, name) && agents[name];
  if (!name || agent.game === game) return name;
  const why = agent ? `plays ${agent.game}, not ${game}`
    : Object.hasOwn(broken ?? {}, name) ? `cannot be opened: ${broken[name]}` : "is not in this lab";
  wrong.push(`The agent ${quoted(name)} ${why}; no agent is shown.`);
  return "";
}

const quoted = (text) => `'${text.slice(0, 80)}${text[80] ? "…" : ""}'`;

// An agent for levels of a variant; "" where there is none.
function firstOf(about, game, variant) {
  const fits = ([, agent]) => agent.game === game && agent.variants.includes(variant);
  return Object.entries(about.agents).find(fits)?.[0] ?? "";
}

export async function toLink({ game, variant, agent, level, number }) {
  const last = number === null ? { drawn: await packed(plain(level)) } : { level: number };
  return `#${new URLSearchParams({ game, variant, agent, ...last })}`;
}

async function packed(level) {
  const bytes = await piped(new TextEncoder().encode(JSON.stringify(level)), CompressionStream);
  return btoa(String.fromCharCode(...bytes)).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
}

async function unpacked(text) {
  try {
    if (text.length > LONGEST) return null;
    const bytes = Uint8Array.from(atob(text.replace(/-/g, "+").replace(/_/g, "/")), (c) => c.charCodeAt(0));
    const level = JSON.parse(new TextDecoder().decode(await piped(bytes, DecompressionStream)));
    const whole = [level.grid, level.agent, ...level.grid].every(Array.isArray);
    return whole && level.agent.length === 2 ? level : null;
  } catch {
    return null;
  }
}

async function piped(bytes, Stream) {
  const stream = new Blob([bytes]).stream().pipeThrough(new Stream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
