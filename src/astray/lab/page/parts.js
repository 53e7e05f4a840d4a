// Small parts of the page that are made anew whenever what they tell changes.

export const percent = (rate) => `${Math.round(100 * rate)}\u00a0%`;

export const counted = (count, thing) => `${count} ${thing}${count === 1 ? "" : "s"}`;

// An element with its properties, and what is in it.
export function made(kind, properties, ...inner) {
  const element = Object.assign(document.createElement(kind), properties);
  element.append(...inner);
  return element;
}

// Fill a choice with [value, text] pairs, and keep what is chosen where it is among them.
export function options(select, pairs, chosen) {
  select.replaceChildren(...pairs.map(([value, textContent, disabled = false]) =>
    made("option", { value, textContent, disabled })));
  if (pairs.some(([value]) => value === chosen)) select.value = chosen;
}

// Name of an object or a goal; in a maze, by its appearance.
export function named(lab, name) {
  const { intended, proxies } = lab.panels.shift ?? {};
  const said = name.split("-").reverse().join(" "); // tomato-dry is a dry tomato
  if (!intended || lab.look.plain) return said;
  const other = proxies.find((proxy) => proxy !== "corner") ?? "other";
  return { goal: intended, other, "goal on other": `${intended} on ${other}` }[name] ?? said;
}

export const capital = (text) => text[0].toUpperCase() + text.slice(1);

// A line of a key: a colour (none: a dashed line) and what it means.
export function keyed(colour, text) {
  const look = colour ? { style: `background: ${colour}` } : { className: "dashed" };
  return made("li", {}, made("i", look), text);
}

// A bar that is as long as a count is of a total.
export function bar(name, count, total, colour) {
  const filled = made("div", { style: `width: ${(100 * count) / total}%; background: ${colour}` });
  return made("div", { className: "bar" }, made("span", {}, name),
    made("div", { className: "track" }, filled),
    made("span", {}, `${count} of ${total} (${percent(count / total)})`));
}

export function fillTable(table, head, rows) {
  const line = (cells, kind) => made("tr", {}, ...cells.map((text) => made(kind, {}, text)));
  table.replaceChildren(line(head, "th"), ...rows.map((cells) => line(cells, "td")));
}

// A number with so many digits after the point; one that rounds to zero has no sign.
export const rounded = (number, digits = 2) => (Number(number.toFixed(digits)) + 0).toFixed(digits);

export const round = (number) => Number(number.toFixed(3));
