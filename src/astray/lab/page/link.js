// Addresses that hold a level and an agent: #game=…&variant=…&agent=…&level=17, or a drawn level.

import { plain } from "./level.js";

const LONGEST = 200_000; // characters of a level in an address

// What an address says; fields that it lacks, or that cannot be, are left out.
export async function fromLink(hash, about) {
  const words = new URLSearchParams(hash.slice(1));
  const found = {};
  const game = words.get("game");
  if (!Object.hasOwn(about.games, game)) return found;
  found.game = game;
  const variants = Object.keys(about.games[game].variants);
  found.variant = variants.includes(words.get("variant")) ? words.get("variant") : variants[0];
  const agent = words.get("agent");
  found.agent = about.agents[agent]?.game === game ? agent : firstOf(about, game, found.variant);
  const number = Number(words.get("level") ?? 0);
  found.level = Number.isInteger(number) && number >= 0 && number < 2 ** 31 - 1 ? number : 0;
  if (words.has("drawn")) found.level = (await unpacked(words.get("drawn"))) ?? found.level;
  return found;
}

// An agent for levels of a variant; "" where there is none.
export function firstOf(about, game, variant) {
  const fits = ([, agent]) => agent.game === game && agent.variants.includes(variant);
  return Object.entries(about.agents).find(fits)?.[0] ?? "";
}

export async function toLink({ game, variant, agent, level, number }) {
  const words = new URLSearchParams({ game, variant });
  if (agent) words.set("agent", agent);
  if (number === null) words.set("drawn", await packed(plain(level)));
  else words.set("level", number);
  return `#${words}`;
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
    return level && typeof level === "object" ? level : null;
  } catch {
    return null;
  }
}

async function piped(bytes, Stream) {
  const stream = new Blob([bytes]).stream().pipeThrough(new Stream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
